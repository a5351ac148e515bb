"""`/api/v1/interfaces/{owner}/{interface}/trace`."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import aclosing
from typing import Annotated

from msgspec import Meta

from master import rights
from master.api.acting import acting, principal
from master.api.calls import Answer, Call, One
from master.api.router import Api, Route
from master.api.streams import Piece, Streams
from master.records import Interface
from master.service import Master
from rce.errors import NotFound
from rce.views import MessageTrace, Traced

PATH = "/interfaces/{owner}/{interface}/trace"


class Trace(One, frozen=True, forbid_unknown_fields=True):
    """How much of it."""

    messages: Annotated[int, Meta(ge=1, le=10_000, description="so many at most")] = 10
    seconds: Annotated[float, Meta(ge=0, le=60, description="for which they are awaited; not with follow")] = 5.0
    follow: Annotated[bool, Meta(description="as server-sent events, as they pass")] = False


class TracesApi:
    """What passes an interface, hop by hop."""

    def __init__(self, master: Master, streams: Streams) -> None:
        self._master = master
        self._streams = streams

    def add_to(self, api: Api) -> None:
        read = (Traced, AsyncIterator[MessageTrace])
        api.add(Route("GET", PATH, self.trace, "Messages that pass an interface, hop by hop", Trace, answer=read))

    async def trace(self, call: Call) -> Answer:
        asked = call.asked(Trace)
        owner, state = call.path["owner"], self._master.state
        user = acting(call, "trace.read", asked.user)
        key = f"{user}/{owner}/{call.path['interface']}"

        def sees(interface: Interface) -> bool:
            tag = interface.spec.owner.partition("/")[2]
            return rights.sees(principal(call), state, "trace.read", user, tag)

        if key not in state.interfaces or not sees(state.interfaces[key]):
            raise NotFound(f"there is no interface {owner[:80]}/{call.path['interface'][:80]}", field="interface")
        messages = self._master.tracer.follow(key, sees)
        if asked.follow:
            return Answer(self._streams.stream(principal(call), _pieces(messages, asked.messages)))
        return Answer(Traced(await _gathered(messages, asked)))


async def _pieces(messages: AsyncIterator[MessageTrace], most: int) -> AsyncIterator[Piece]:
    async with aclosing(messages):  # type: ignore[type-var]  # it is a generator
        async for message in messages:
            yield Piece("", "", message)
            most -= 1
            if not most:
                return


async def _gathered(messages: AsyncIterator[MessageTrace], asked: Trace) -> list[MessageTrace]:
    found: list[MessageTrace] = []
    try:
        async with asyncio.timeout(asked.seconds), aclosing(messages):  # type: ignore[type-var]  # as above
            async for message in messages:
                found.append(message)
                if len(found) == asked.messages:
                    break
    except TimeoutError:
        pass
    return found
