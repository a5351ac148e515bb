"""`…/log`: output of nodes and environments, read from the Environment endpoint, which keeps it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated

from msgspec import Meta

from master.api.events import LAST_EVENT_ID
from master.api.principals import authorize, principal_of
from master.api.request import Answer, Call, OwnerQuery
from master.api.router import Api, Route
from master.api.streams import EventStreams, ServerSentEvent
from master.service import ASK_TIMEOUT, Master
from rce.api.views import LogLines
from rce.control.calls.watching import Log, ReadLog
from rce.errors import NotFound

AT = "/environments/{environment}"
POLL_TIMEOUT = 10.0  # seconds for which the environment waits for new lines before it answers without


class LogQuery(OwnerQuery, frozen=True, forbid_unknown_fields=True):
    """Query of a log."""

    lines: Annotated[int, Meta(ge=0, le=10_000, description="maximum number of lines, the last ones")] = 100
    follow: Annotated[bool, Meta(description="go on with new lines, as server-sent events")] = False
    after: Annotated[str, Meta(max_length=40, description="`next` of an earlier answer: lines that came since")] = ""


class EnvironmentLogQuery(LogQuery, frozen=True, forbid_unknown_fields=True):
    """Query of the log of an environment itself."""

    verbose: Annotated[bool, Meta(description="with what is internal, as the Master's calls")] = False


class LogsApi:
    """Routes of logs."""

    def __init__(self, master: Master, streams: EventStreams) -> None:
        self._master = master
        self._streams = streams

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        read = (LogLines, AsyncIterator[LogLines])
        of_node = "Output of a node, also after its end"
        api.add(
            Route(
                "GET",
                AT + "/log",
                self._read_environment,
                "Log of the environment itself",
                EnvironmentLogQuery,
                answer=read,
            ),
            Route("GET", AT + "/nodes/{node}/log", self._read_node, of_node, LogQuery, answer=read),
        )

    async def _read_environment(self, call: Call) -> Answer:
        query = call.query(EnvironmentLogQuery)
        return await self._read(call, "environment.log", "", query, query.verbose)

    async def _read_node(self, call: Call) -> Answer:
        return await self._read(call, "node.log", call.path["node"], call.query(LogQuery))

    async def _read(self, call: Call, operation: str, node: str, query: LogQuery, verbose: bool = False) -> Answer:
        tag = call.path["environment"]
        user = authorize(call, operation, query.user, environment=tag)
        name = f"{user}/{tag}"
        log = await self._ask(
            name, ReadLog(node, query.lines, call.header(LAST_EVENT_ID) or query.after, verbose=verbose)
        )
        if not query.follow:
            return Answer(LogLines(log.lines, log.next))
        return Answer(self._streams.stream(principal_of(call), self._follow(name, node, log, verbose)))

    async def _ask(self, name: str, question: ReadLog) -> Log:
        environment = self._master.state.environments.get(name)
        if environment is None:
            raise NotFound(f"there is no environment {name.partition('/')[2][:80]!r}", field="environment")
        return await self._master.ask(environment, question, ASK_TIMEOUT + question.wait)

    async def _follow(self, name: str, node: str, log: Log, verbose: bool) -> AsyncIterator[ServerSentEvent]:
        while True:
            if log.lines:
                yield ServerSentEvent(log.next, "", LogLines(log.lines, log.next))
            log = await self._ask(name, ReadLog(node, after=log.next, wait=POLL_TIMEOUT, verbose=verbose))
