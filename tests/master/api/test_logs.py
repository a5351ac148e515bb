"""Logs over HTTP: the last lines, and new lines as they come."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from twisted.internet.base import ReactorBase

from rce.control.calls.watching import Log, ReadLog
from rce.errors import NotFound
from rce.protocol import messages as m
from tests.support.master.served import Served, serve
from tests.support.master.sse import follow


class Output:
    """Output of a node at its Environment endpoint."""

    def __init__(self) -> None:
        self.lines: list[str] = ["one", "two"]
        self.more = asyncio.Event()

    async def read(self, call: ReadLog) -> Log:
        if call.node not in ("", "n"):
            raise NotFound(f"no node {call.node} was started in this environment", field="nodeTag")
        if not call.after:
            return Log(self.lines[-call.lines :], str(len(self.lines)))
        if call.wait and int(call.after) == len(self.lines):
            self.more.clear()
            await self.more.wait()
        return Log(self.lines[int(call.after) :], str(len(self.lines)))

    def print(self, line: str) -> None:
        self.lines.append(line)
        self.more.set()


async def test_logs_are_read_and_followed(reactor: ReactorBase, tmp_path: Path) -> None:
    async with serve(reactor, tmp_path) as served:
        await served.master.commands.execute("ann", m.CreateContainer("brain"))
        output = Output()
        served.peers["ann/brain"].answers[ReadLog] = output.read
        path = "/environments/brain/nodes/n/log"
        assert (await served.ask("GET", path + "?lines=1")).body == {"lines": ["two"], "next": "2"}
        assert (await served.ask("GET", "/environments/brain/log?after=1")).body["lines"] == ["two"]
        await refused(served)
        follower = await follow(served, path + "?follow=true&lines=1", "ann")
        assert (await follower.next())["lines"] == ["two"]
        output.print("three")
        assert await follower.next() == {"lines": ["three"], "next": "3"}
        await follower.close()
        again = await follow(served, path + "?follow=1", "ann", Last_Event_ID="2")
        assert (await again.next())["lines"] == ["three"]
        served.peers["ann/brain"].close()
        await served.master.commands.execute("ann", m.DestroyContainer("brain"))
        output.print("four")
        assert (await again.next())["lines"] == ["four"]
        assert (await again.next())["code"] in ("not_found", "unavailable")
        assert await again.next() is None
        await again.close()


async def refused(served: Served) -> None:
    status: Any
    for path, user, status in (
        ("/environments/brain/nodes/never/log", "ann", 404),
        ("/environments/none/log", "ann", 404),
        ("/environments/brain/log?user=ann", "bob", 404),
        ("/environments/brain/log?lines=10001", "ann", 400),
    ):
        assert (await served.ask("GET", path, user)).status == status
