"""`/api/v1/interfaces/{owner}/{interface}/trace`: messages with the hops that they pass."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import aclosing
from typing import Annotated

from msgspec import Meta

from master.access import rights
from master.api.principals import authorize, principal_of
from master.api.request import Answer, Call, OwnerQuery
from master.api.router import Api, Route
from master.api.streams import EventStreams, ServerSentEvent
from master.graph.records import Interface
from master.service import Master
from rce.api.views import MessageTrace, Traced
from rce.errors import NotFound

PATH = "/interfaces/{owner}/{interface}/trace"


class TraceQuery(OwnerQuery, frozen=True, forbid_unknown_fields=True):
    """Query of a trace."""

    messages: Annotated[int, Meta(ge=1, le=10_000, description="maximum number of messages")] = 10
    seconds: Annotated[float, Meta(ge=0, le=60, description="seconds to wait for them; without follow")] = 5.0
    follow: Annotated[bool, Meta(description="go on as server-sent events")] = False


class TracesApi:
    """Route of traces."""

    def __init__(self, master: Master, streams: EventStreams) -> None:
        self._master = master
        self._streams = streams

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        read = (Traced, AsyncIterator[MessageTrace])
        api.add(Route("GET", PATH, self._trace, "Messages that pass an interface, hop by hop", TraceQuery, answer=read))

    async def _trace(self, call: Call) -> Answer:
        query = call.query(TraceQuery)
        owner, state = call.path["owner"], self._master.state
        user = authorize(call, "trace.read", query.user)
        key = f"{user}/{owner}/{call.path['interface']}"

        def sees(interface: Interface) -> bool:
            tag = interface.owner.partition("/")[2]
            return rights.sees(principal_of(call), state, "trace.read", user, tag)

        if key not in state.interfaces or not sees(state.interfaces[key]):
            raise NotFound(f"there is no interface {owner[:80]}/{call.path['interface'][:80]}", field="interface")
        messages = self._master.tracer.follow(key, sees)
        if query.follow:
            return Answer(self._streams.stream(principal_of(call), _events(messages, query.messages)))
        return Answer(Traced(await _collect(messages, query)))


async def _events(messages: AsyncIterator[MessageTrace], count: int) -> AsyncIterator[ServerSentEvent]:
    async with aclosing(messages):  # type: ignore[type-var]  # it is a generator
        async for message in messages:
            yield ServerSentEvent("", "", message)
            count -= 1
            if not count:
                return


async def _collect(messages: AsyncIterator[MessageTrace], query: TraceQuery) -> list[MessageTrace]:
    found: list[MessageTrace] = []
    try:
        async with asyncio.timeout(query.seconds), aclosing(messages):  # type: ignore[type-var]  # as above
            async for message in messages:
                found.append(message)
                if len(found) == query.messages:
                    break
    except TimeoutError:
        pass
    return found
