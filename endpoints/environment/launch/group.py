"""The nodes of a launch file that run: they start and end together, and some are started again."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from twisted.logger import Logger

from endpoints.environment.launch.evaluation import LaunchedNode
from endpoints.environment.node import NodeProcess
from endpoints.environment.output_log import OutputLog
from rce.control.calls.endpoints import Launched, NodeDied, NodeSpec
from rce.errors import RceError, clipped

STEADY = 5.0  # seconds; the pauses before new starts grow while a node does not run this long
PAUSE_FIRST, PAUSE_MOST = 0.5, 30.0  # seconds
LAST_LINES = 20

log = Logger()


@dataclass
class Member:
    """A node of the launch: as the Master knows it, and as the launch file describes it."""

    spec: NodeSpec
    node: LaunchedNode
    pause: float = 0.0  # seconds before the last new start


Run = Callable[[Member, Callable[[NodeProcess, int], None]], Awaitable[NodeProcess]]
"""Starts the process of a member; the callback gets its end."""


class LaunchGroup:
    """The running nodes of one launch.

    Args:
        spec: The launch.
        members: Its nodes.
        output: Log of the launch itself.
        run: Starts a process.
        report: Sends a report to the Master.
    """

    def __init__(
        self,
        spec: NodeSpec,
        members: list[Member],
        output: OutputLog,
        run: Run,
        report: Callable[[NodeDied | Launched], None],
    ) -> None:
        self.spec = spec
        self.running: dict[str, NodeProcess] = {}
        self._members = members
        self._output = output
        self._run = run
        self._report = report
        self._waiting: dict[str, asyncio.Task[None]] = {}  # members that start later
        self._started = time.monotonic()
        self._status = 0
        self._stopping = False
        self.over: asyncio.Future[NodeDied] = asyncio.get_running_loop().create_future()
        """Done when no node runs or will run, unless the launch was stopped."""

    async def start(self) -> None:
        """Start all nodes and report them.

        Raises:
            RceError: A node did not start; then none runs.
        """
        now = [each for each in self._members if not each.node.delay]
        self._report(Launched(self.spec.tag, [each.spec for each in now]))  # before one of them can end
        started = await asyncio.gather(*map(self._start, now), return_exceptions=True)
        errors = [each for each in started if isinstance(each, BaseException)]
        if errors:
            await self.stop()
            self.tell()
            raise errors[0]
        for member in self._members:
            if member.node.delay:
                self._later(member, member.node.delay)

    def tell(self) -> None:
        """Report the nodes that run."""
        self._report(Launched(self.spec.tag, [each.spec for each in self._members if each.spec.tag in self.running]))

    async def stop(self) -> None:
        """Stop all nodes."""
        self._stopping = True
        for task in self._waiting.values():
            task.cancel()
        self._waiting.clear()
        await asyncio.gather(*(node.stop() for node in list(self.running.values())))
        self._output.close()

    async def _start(self, member: Member) -> None:
        process = await self._run(member, lambda process, status: self._ended(member, process, status))
        self.running[member.spec.tag] = process
        self._say(f"{member.spec.tag} started: {member.node.package} {member.node.executable}")

    def _later(self, member: Member, seconds: float) -> None:
        self._waiting[member.spec.tag] = asyncio.create_task(self._start_later(member, seconds))

    async def _start_later(self, member: Member, seconds: float) -> None:
        await asyncio.sleep(seconds)
        tag = member.spec.tag
        try:
            await self._start(member)
        except RceError as error:
            self._say(f"{tag} did not start: {error}")
            self._report(NodeDied(tag, 1, [clipped(error.info).message]))
            self._status = self._status or 1
        else:
            self.tell()
        finally:
            self._waiting.pop(tag, None)
        self._conclude()

    def _ended(self, member: Member, process: NodeProcess, status: int) -> None:
        tag = member.spec.tag
        self.running.pop(tag, None)
        if self._stopping or process.stopping:
            return
        seconds = time.monotonic() - process.started
        self._say(f"{tag} ended with status {status}")
        again = member.node.respawn
        self._report(NodeDied(tag, status, process.output.last_lines(LAST_LINES), seconds, again))
        if again:
            grown = PAUSE_FIRST if seconds >= STEADY else min(PAUSE_MOST, max(PAUSE_FIRST, 2 * member.pause))
            member.pause = grown
            self._later(member, max(member.node.respawn_delay, grown))
            return
        self._status = self._status or status
        if member.node.required:
            self._say(f"the launch ends with {tag}")
            self._ending = asyncio.create_task(self._end())
        else:
            self._conclude()

    async def _end(self) -> None:
        for task in self._waiting.values():
            task.cancel()
        self._waiting.clear()
        await asyncio.gather(*(node.stop() for node in list(self.running.values())))
        self._conclude()

    def _conclude(self) -> None:
        if self._stopping or self.running or self._waiting or self.over.done():
            return
        lines = self._output.last_lines(LAST_LINES)
        self.over.set_result(NodeDied(self.spec.tag, self._status, lines, time.monotonic() - self._started))

    def _say(self, text: str) -> None:
        log.info("{text}", text=text)
        self._output.write(f"{text}\n".encode())
