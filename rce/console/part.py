"""The console as a robot: how it takes part in the topics and services of an environment, and leaves nothing behind."""

from __future__ import annotations

import asyncio
import re
import signal
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from typing import TypeVar

from rce import views
from rce.calls.watching import RosName
from rce.client import Robot
from rce.console.session import Session
from rce.errors import InvalidRequest, NotFound
from rce.messages import InterfaceType, Qos, RemoveInterface, RemoveNode

T = TypeVar("T")
_own = re.compile(r"(console_[0-9a-f]{6})_\w+")


class Part:
    """One environment, as the console's robot uses it. What it makes there has names that begin with the robot's."""

    def __init__(self, session: Session, robot: Robot, environment: str) -> None:
        self.robot = robot
        self.environment = environment
        self._session = session
        self._made: list[RemoveInterface | RemoveNode] = []

    async def interface(self, name: str, kind: InterfaceType, type_name: str, address: str, qos: Qos) -> str:
        """An interface in the environment, as `endpoint/interface`."""
        tag = f"{self.robot.name}_{name}"
        await self.robot.add_interface(self.environment, tag, kind, type_name, addr=address, qos=qos)
        self._made.append(RemoveInterface(self.environment, tag))
        return f"{self.environment}/{tag}"

    async def node(self, name: str, pkg: str, exe: str, args: str) -> str:
        """A node in the environment; its tag."""
        tag = f"{self.robot.name}_{name}"
        await self.robot.add_node(self.environment, tag, pkg, exe, args=args)
        self._made.append(RemoveNode(self.environment, tag))
        return tag

    async def names(self, kind: str) -> list[RosName]:
        """The `topics` or `services` that ROS has in the environment now."""
        api, environment = self._session.api, self.environment
        return await asyncio.to_thread(lambda: list(api.items(RosName, "environments", environment, kind)))

    async def leave(self) -> None:
        """Remove what was made here; what has gone by itself is well."""
        for command in reversed(self._made):
            with suppress(NotFound):
                await self.robot.configure(command)

    def tidy(self) -> None:
        """Remove the interfaces of consoles that were killed."""
        api = self._session.api
        found = [each.interfaceTag for each in api.items(views.InterfaceView, "interfaces", owner=self.environment)]
        left = [(match[1], tag) for tag in found if (match := _own.fullmatch(tag))]
        if not left:
            return
        present = {each.robotID for each in api.items(views.RobotView, "robots")}
        for robot, tag in left:
            if robot not in present:
                with suppress(NotFound):
                    api.delete("interfaces", self.environment, tag)


@asynccontextmanager
async def taking_part(session: Session, environment: str) -> AsyncIterator[Part]:
    """Be a robot, for a while."""
    async with session.robot() as robot:
        part = Part(session, robot, environment)
        await asyncio.to_thread(part.tidy)
        try:
            yield part
        finally:
            await asyncio.shield(part.leave())


def attend(work: Callable[[], Awaitable[int]]) -> int:
    """Run until it is done; the signals by which terminals and systems end a program let it leave in order."""

    async def run() -> int:
        task = asyncio.current_task()
        assert task is not None
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGHUP):
            loop.add_signal_handler(number, task.cancel)
        return await work()

    try:
        return asyncio.run(run())
    except asyncio.CancelledError:
        return 128 + signal.SIGTERM


def split(place: str) -> tuple[str, str]:
    """`ENV/TOPIC` in the environment and the name that ROS knows. InvalidRequest."""
    environment, slash, name = place.partition("/")
    if not (environment and slash and name.strip("/")):
        raise InvalidRequest(f"{place!r} names no topic or service of an environment: write ENV/NAME, as brain/pose")
    return environment, "/" + name.lstrip("/")
