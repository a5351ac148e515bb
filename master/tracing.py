"""Messages of one interface, followed through the endpoints at both of its ends.

Each endpoint notes what passes while it is asked for it; the parts of a message have its id in common.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field

from twisted.logger import Logger

from master.carrier import Carrier
from master.records import Interface, State
from rce.calls.watching import FollowMessages, Passage
from rce.errors import RceError
from rce.views import HopView, MessageTrace

PERIOD = 0.25  # seconds between questions
QUIET = 1.0  # seconds after its last hop at which a message is taken for complete
MOST = 10_000  # messages that are not yet complete

log = Logger()


@dataclass
class _Message:
    began: bool = False  # its first hop is known
    touched: float = 0.0
    passages: list[Passage] = field(default_factory=list)


class Joined:
    """Puts the passages of each message together."""

    def __init__(self) -> None:
        self._messages: dict[tuple[str, str], _Message] = {}

    def add(self, passage: Passage, now: float) -> list[Passage] | None:
        """Returns the message before, if this begins another with the same id: ids are the robots' own affair."""
        key = (passage.source, passage.message)
        first = passage.hop == "entered" and passage.interface == passage.source
        before = self._messages.pop(key) if first and key in self._messages and self._messages[key].began else None
        message = self._messages.setdefault(key, _Message())
        message.began = message.began or first
        message.touched = now
        message.passages.append(passage)
        return before.passages if before else None

    def complete(self, now: float) -> list[list[Passage]]:
        """The messages of which no more is expected."""
        keys = [key for key, each in self._messages.items() if now - each.touched >= QUIET]
        keys = keys or list(self._messages)[: max(0, len(self._messages) - MOST)]
        return [self._messages.pop(key).passages for key in keys]


class Tracer:
    """Follows messages of interfaces."""

    def __init__(self, state: State, carrier: Carrier) -> None:
        self._state = state
        self._carrier = carrier

    async def follow(self, interface: str, sees: Callable[[Interface], bool]) -> AsyncIterator[MessageTrace]:
        """Those of the interface of this key, as they are complete, until it is gone; of its peers those that `sees`
        lets be seen.
        """
        name, joined, loop = secrets.token_hex(8), Joined(), asyncio.get_running_loop()
        while interface in self._state.interfaces:
            rest = asyncio.create_task(asyncio.sleep(PERIOD))
            known = {each.spec.id: each for each in self._concerned(interface) if sees(each)}
            for passages in await self._ask(name, known):
                for passage in passages:
                    if (before := joined.add(passage, loop.time())) is not None:
                        yield self._shown(before, known)
            for message in joined.complete(loop.time()):
                yield self._shown(message, known)
            await rest

    def _concerned(self, interface: str) -> list[Interface]:
        state = self._state
        keys = {side for each in state.connections.by(interface) for side in (each.sender, each.receiver)}
        return [state.interfaces[key] for key in sorted(keys | {interface})]

    async def _ask(self, name: str, known: dict[str, Interface]) -> list[list[Passage]]:
        at: dict[str, list[str]] = {}
        for id, interface in known.items():
            at.setdefault(self._state.host(interface.spec.owner), []).append(id)
        at.pop("", None)
        return await asyncio.gather(*(self._passages(process, name, ids) for process, ids in at.items()))

    async def _passages(self, process: str, name: str, ids: list[str]) -> list[Passage]:
        try:
            return (await self._carrier.ask(process, FollowMessages(name, ids), 2.0)).passages
        except RceError as error:  # what passed there is missing from the messages
            log.info("{process} was not asked for its hops: {error}", process=process, error=str(error))
            return []

    def _shown(self, passages: list[Passage], known: dict[str, Interface]) -> MessageTrace:
        seen = sorted((each for each in passages if each.interface in known), key=lambda each: each.time)
        source = known.get(passages[0].source)
        hops = [self._hop(each, known[each.interface]) for each in seen]
        return MessageTrace(passages[0].message, _tag(source) if source else "", hops)

    def _hop(self, passage: Passage, interface: Interface) -> HopView:
        process = self._state.processes.get(self._state.host(interface.spec.owner))
        return HopView(_tag(interface), passage.hop, passage.time, process.host if process else "")


def _tag(interface: Interface) -> str:
    return interface.key.partition("/")[2]
