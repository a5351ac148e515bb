"""The console as a guest: how it takes part in the topics and services of an environment, and leaves nothing behind."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import TypeVar

from rce.calls.watching import RosName
from rce.client import Robot
from rce.console.session import Session
from rce.errors import InvalidRequest
from rce.messages import InterfaceType, Qos

T = TypeVar("T")


class Part:
    """One environment of `owner`'s (empty: of who asks), as the guest `robot` uses it."""

    def __init__(self, session: Session, robot: Robot, environment: str, owner: str = "") -> None:
        self.robot = robot
        self.environment = environment
        self.owner = owner
        self._session = session

    async def interface(self, name: str, kind: InterfaceType, type_name: str, address: str, qos: Qos) -> str:
        """An interface in the environment, as `endpoint/interface`."""
        tag = f"{self.robot.name}.{name}"
        await self.robot.add_interface(self.environment, tag, kind, type_name, addr=address, qos=qos)
        return f"{self.environment}/{tag}"

    async def node(self, name: str, pkg: str, exe: str, args: str) -> str:
        """A node in the environment; its tag."""
        tag = f"{self.robot.name}.{name}"
        await self.robot.add_node(self.environment, tag, pkg, exe, args=args)
        return tag

    async def names(self, kind: str) -> list[RosName]:
        """The `topics` or `services` that ROS has in the environment now."""
        found = self._session.api.items
        return await asyncio.to_thread(
            lambda: list(found(RosName, "environments", self.environment, kind, user=self.owner))
        )


@asynccontextmanager
async def taking_part(session: Session, environment: str, owner: str) -> AsyncIterator[Part]:
    """Be a guest, for a while; all that it made goes with it."""
    async with session.guest(owner) as robot:
        yield Part(session, robot, environment, owner)


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
