"""`…/log`: the output of nodes and environments, read where it is: at the Environment endpoint."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated

from msgspec import Meta

from master.api.acting import acting, principal
from master.api.calls import Answer, Call, One
from master.api.events import LAST
from master.api.router import Api, Route
from master.api.streams import Piece, Streams
from master.service import Master
from rce.calls.watching import Log, ReadLog
from rce.errors import NotFound
from rce.views import LogLines

AT = "/environments/{environment}"
WAIT = 10.0  # seconds after which the environment is asked again, whether it has said something or not


class Lines(One, frozen=True, forbid_unknown_fields=True):
    """Which lines."""

    lines: Annotated[int, Meta(ge=0, le=10_000, description="the last ones, so many at most")] = 100
    follow: Annotated[bool, Meta(description="go on, as server-sent events")] = False
    after: Annotated[str, Meta(max_length=40, description="`next` of an earlier answer: what has come since")] = ""


class LogsApi:
    """The routes of logs."""

    def __init__(self, master: Master, streams: Streams) -> None:
        self._master = master
        self._streams = streams

    def add_to(self, api: Api) -> None:
        read = (LogLines, AsyncIterator[LogLines])
        of_node = "What a node has printed, also one that has ended"
        api.add(
            Route("GET", AT + "/log", self.environment, "What the environment itself logs", Lines, answer=read),
            Route("GET", AT + "/nodes/{node}/log", self.node, of_node, Lines, answer=read),
        )

    async def environment(self, call: Call) -> Answer:
        return await self._read(call, "environment.log", "")

    async def node(self, call: Call) -> Answer:
        return await self._read(call, "node.log", call.path["node"])

    async def _read(self, call: Call, operation: str, node: str) -> Answer:
        asked, tag = call.asked(Lines), call.path["environment"]
        user = acting(call, operation, asked.user, environment=tag)
        name = f"{user}/{tag}"
        log = await self._ask(name, ReadLog(node, asked.lines, call.header(LAST) or asked.after))
        if not asked.follow:
            return Answer(LogLines(log.lines, log.next))
        return Answer(self._streams.stream(principal(call), self._follow(name, node, log)))

    async def _ask(self, name: str, question: ReadLog) -> Log:
        environment = self._master.state.environments.get(name)
        if environment is None:
            raise NotFound(f"there is no environment {name.partition('/')[2][:80]!r}", field="environment")
        return await self._master.ask(environment, question)

    async def _follow(self, name: str, node: str, log: Log) -> AsyncIterator[Piece]:
        while True:
            if log.lines:
                yield Piece(log.next, "", LogLines(log.lines, log.next))
            log = await self._ask(name, ReadLog(node, after=log.next, wait=WAIT))
