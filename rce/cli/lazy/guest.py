"""The console as a guest robot: its access to topics, services and nodes of an environment."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from rce.cli.session import ConsoleSession
from rce.client import Robot
from rce.control.calls.robots import Definitions
from rce.control.calls.watching import RosName
from rce.errors import InvalidRequest
from rce.protocol.messages import InterfaceType, Qos


class Guest:
    """One environment of `owner` (empty: of the session's user), as the guest `robot` uses it."""

    def __init__(self, session: ConsoleSession, robot: Robot, environment: str, owner: str = "") -> None:
        self.robot = robot
        self.environment = environment
        self.owner = owner
        self._session = session

    async def add_interface(self, name: str, kind: InterfaceType, type_name: str, address: str, qos: Qos) -> str:
        """Add an interface to the environment and return its name, `endpoint/interface`."""
        tag = f"{self.robot.name}.{name}"
        await self.robot.add_interface(self.environment, tag, kind, type_name, addr=address, qos=qos)
        return f"{self.environment}/{tag}"

    async def add_node(self, name: str, pkg: str, exe: str, args: str) -> str:
        """Start a node in the environment and return its tag."""
        tag = f"{self.robot.name}.{name}"
        await self.robot.add_node(self.environment, tag, pkg, exe, args=args)
        return tag

    async def ros_names(self, kind: str) -> list[RosName]:
        """Return the `topics` or `services` that ROS has in the environment at present."""
        items = self._session.api.items
        return await asyncio.to_thread(
            lambda: list(items(RosName, "environments", self.environment, kind, user=self.owner))
        )

    async def describe(self, type_name: str) -> Definitions:
        """Return the definition of a message type that the environment knows."""
        path, get = ("environments", self.environment, "types"), self._session.api.get
        return await asyncio.to_thread(lambda: get(Definitions, *path, type=type_name, sort="msg", user=self.owner))


@asynccontextmanager
async def guest_in(session: ConsoleSession, environment: str, owner: str) -> AsyncIterator[Guest]:
    """Connect as a guest; the platform removes all that the guest added when it disconnects."""
    async with session.guest(owner) as robot:
        yield Guest(session, robot, environment, owner)


def run_until_signal(work: Callable[[], Awaitable[int]]) -> int:
    """Run a coroutine and return its exit status; SIGTERM and SIGHUP cancel it, so that it cleans up."""

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


def split_address(address: str) -> tuple[str, str]:
    """Split `ENV/NAME` into the environment and the ROS name, with a slash at the beginning.

    Raises:
        InvalidRequest: The address has another form.
    """
    environment, slash, name = address.partition("/")
    if not (environment and slash and name.strip("/")):
        raise InvalidRequest(f"{address!r} names no topic or service of an environment: write ENV/NAME, as brain/pose")
    return environment, "/" + name.lstrip("/")
