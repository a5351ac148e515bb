"""Tracing: messages of one interface, followed hop by hop through the endpoints at both of its ends.

Each endpoint records hops while it is asked for them; the hops of a message have its id in common.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field

from twisted.logger import Logger

from master.execution.dispatcher import Dispatcher
from master.graph.records import Interface
from master.graph.state import State
from rce.api.views import HopView, MessageTrace
from rce.control.calls.watching import FollowMessages, HopRecord
from rce.errors import RceError

PERIOD = 0.25  # seconds between requests
QUIET = 1.0  # seconds after its last hop, when a message counts as complete
MAX_INCOMPLETE = 10_000  # messages

log = Logger()


@dataclass
class _Message:
    began: bool = False  # its first hop was seen
    touched: float = 0.0
    passages: list[HopRecord] = field(default_factory=list)


class HopCollector:
    """Collects the hops of each message."""

    def __init__(self) -> None:
        self._messages: dict[tuple[str, str], _Message] = {}

    def add(self, passage: HopRecord, now: float) -> list[HopRecord] | None:
        """Add a hop. Return the earlier message if this hop begins another with the same id: robots choose the ids."""
        key = (passage.source, passage.message)
        first = passage.hop == "entered" and passage.interface == passage.source
        before = self._messages.pop(key) if first and key in self._messages and self._messages[key].began else None
        message = self._messages.setdefault(key, _Message())
        message.began = message.began or first
        message.touched = now
        message.passages.append(passage)
        return before.passages if before else None

    def complete(self, now: float) -> list[list[HopRecord]]:
        """Return the hops of messages that are complete."""
        keys = [key for key, each in self._messages.items() if now - each.touched >= QUIET]
        keys = keys or list(self._messages)[: max(0, len(self._messages) - MAX_INCOMPLETE)]
        return [self._messages.pop(key).passages for key in keys]


class Tracer:
    """Follows messages of interfaces."""

    def __init__(self, state: State, dispatcher: Dispatcher) -> None:
        self._state = state
        self._dispatcher = dispatcher

    async def follow(self, interface: str, sees: Callable[[Interface], bool]) -> AsyncIterator[MessageTrace]:
        """Yield the messages of an interface as they are complete, until it is removed.

        Hops at peers are included if `sees` allows them.
        """
        name, joined, loop = secrets.token_hex(8), HopCollector(), asyncio.get_running_loop()
        while interface in self._state.interfaces:
            rest = asyncio.create_task(asyncio.sleep(PERIOD))
            known = {each.id: each for each in self._concerned(interface) if sees(each)}
            told = [each for passages in await self._ask(name, known) for each in passages]
            for passage in sorted(told, key=lambda each: each.time):  # all messages of a topic may have the same id
                if (before := joined.add(passage, loop.time())) is not None:
                    yield self._shown(before, known)
            for message in joined.complete(loop.time()):
                yield self._shown(message, known)
            await rest

    def _concerned(self, interface: str) -> list[Interface]:
        state = self._state
        keys = {side for each in state.connections.by(interface) for side in (each.sender, each.receiver)}
        return [state.interfaces[key] for key in sorted(keys | {interface})]

    async def _ask(self, name: str, known: dict[str, Interface]) -> list[list[HopRecord]]:
        at: dict[str, list[str]] = {}
        for id, interface in known.items():
            at.setdefault(self._state.host(interface.owner), []).append(id)
        at.pop("", None)
        return await asyncio.gather(*(self._passages(process, name, ids) for process, ids in at.items()))

    async def _passages(self, process: str, name: str, ids: list[str]) -> list[HopRecord]:
        try:
            return (await self._dispatcher.ask(process, FollowMessages(name, ids), 2.0)).records
        except RceError as error:  # its hops are missing from the messages
            log.info("{process} did not report its hops: {error}", process=process, error=str(error))
            return []

    def _shown(self, passages: list[HopRecord], known: dict[str, Interface]) -> MessageTrace:
        seen = sorted((each for each in passages if each.interface in known), key=lambda each: each.time)
        source = known.get(passages[0].source)
        hops = [self._hop(each, known[each.interface]) for each in seen]
        return MessageTrace(passages[0].message, _tag(source) if source else "", hops)

    def _hop(self, passage: HopRecord, interface: Interface) -> HopView:
        process = self._state.processes.get(self._state.host(interface.owner))
        return HopView(_tag(interface), passage.hop, passage.time, process.host if process else "")


def _tag(interface: Interface) -> str:
    return interface.key.partition("/")[2]
