"""ROS graphs of environments, read while somebody wants them, once for all clients of gateways that ask meanwhile."""

from __future__ import annotations

import asyncio
import time

from rce.control.calls.robots import ReadGraphFor
from rce.control.calls.watching import RosGraph
from rce.control.client import ControlClient

FRESH = 1.0  # seconds for which a graph need not be read again
KEPT = 60.0  # seconds


class Graphs:
    """Graphs by the names of their environments, `userID/tag`."""

    def __init__(self) -> None:
        self._read: dict[str, tuple[float, RosGraph]] = {}
        self._reading: dict[str, asyncio.Task[RosGraph]] = {}

    async def read(self, master: ControlClient, robot: str, environment: str, since: float | None = None) -> RosGraph:
        """Return the graph of an environment.

        Args:
            master: The Master, which checks the rights of the robot.
            robot: Name of the guest that asks.
            environment: Tag of the environment.
            since: An answer is good enough if it was asked for at this monotonic time or later, by default `FRESH`
                seconds ago.

        Raises:
            RceError: The robot may not see the environment, or it cannot be asked at present.
        """
        name = f"{robot.partition('/')[0]}/{environment}"
        since = time.monotonic() - FRESH if since is None else since
        while (found := self._read.get(name)) is None or found[0] < since:
            task = self._reading.get(name)  # which may have begun too early
            if task is None or task.done():
                task = self._reading[name] = asyncio.create_task(self._ask(master, robot, name, environment))
                task.add_done_callback(lambda done: self._done(name, done))
            await asyncio.shield(task)
        return found[1]

    async def check(self, master: ControlClient, robot: str, environment: str) -> RosGraph:
        """Read the graph anew, so that the Master checks the rights of this robot; see `read`."""
        return await self._ask(master, robot, f"{robot.partition('/')[0]}/{environment}", environment)

    async def _ask(self, master: ControlClient, robot: str, name: str, environment: str) -> RosGraph:
        since = time.monotonic()
        graph = await master.call(ReadGraphFor(robot, environment))
        self._forget_old(since)
        self._read[name] = since, graph
        return graph

    def _done(self, name: str, task: asyncio.Task[RosGraph]) -> None:
        if self._reading.get(name) is task:
            del self._reading[name]
        if not task.cancelled():
            task.exception()  # who waited for it may have left

    def _forget_old(self, now: float) -> None:
        for name in [name for name, (at, _) in self._read.items() if at < now - KEPT]:
            del self._read[name]
