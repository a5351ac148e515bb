"""Real Master with a simulated crowd of robots, each with an environment, and traffic between them.

The robot endpoint runs in this process; the environments are those of a task set with the fake engine (the program
`containers.hollow`).
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

from twisted.internet.base import ReactorBase

from rce.api import views
from rce.api.client import ApiClient
from rce.bench.hollow import join
from rce.control.calls.robots import Execute, Login
from rce.control.connection import Control
from rce.process.ready import Ready
from rce.process.supervisor import ManagedProcess
from rce.protocol import messages as m

USER = "testUser"  # user of a Master in development mode
MAX_CONCURRENT = 20  # calls at a time
TYPE = "std_msgs/String"
SIDES = (("robot", "SubscriberConverter"), ("brain", "PublisherInterface"))


class Size(NamedTuple):
    """Size of a crowd.

    Attributes:
        robots: Number of robots, each with one environment.
        each: Number of interfaces of each robot and of each environment; all but one are connected.
    """

    robots: int
    each: int

    @property
    def interfaces(self) -> int:
        """Number of all interfaces."""
        return 2 * self.robots * self.each


class Crowded(NamedTuple):
    """Running Master: its URL, the id of its process, and an API key of USER."""

    url: str
    pid: int
    key: str


@asynccontextmanager
async def crowd(reactor: ReactorBase, directory: Path, size: Size, log: IO[str]) -> AsyncIterator[Crowded]:
    """Run a Master with a crowd.

    Args:
        reactor: Twisted's reactor.
        directory: Directory for the data.
        size: Size of the crowd.
        log: File for the logs of the programs.

    Raises:
        StartFailed: A program did not start.
    """
    tokens = {"robot": secrets.token_hex(32), "container": secrets.token_hex(32)}
    allowed = f"robot:west:{tokens['robot']},container:hollow:{tokens['container']}"
    master = ManagedProcess("master", lambda: _master(directory), {"RCE_TOKENS": allowed}, log)
    ready: Ready | None = None

    def machine_words() -> list[str]:
        assert ready is not None
        return [f"--data-dir={directory / 'container'}", f"--master={ready.control}", f"--size={size.robots}"]

    machine = ManagedProcess("hollow-machine", machine_words, {"RCE_TOKEN": tokens["container"]}, log)
    try:
        ready = await master.start()
        await machine.start()
        robots = await join(reactor, ready.control, "robot", "west", tokens["robot"], "ws://127.0.0.1:1/")
        try:
            key = await asyncio.to_thread(create_key, ready.url)
            await _fill(robots, key, size)
            yield Crowded(ready.url, master.pid, key)
        finally:
            robots.close()
    finally:
        await machine.stop()
        await master.stop()


def _master(directory: Path) -> list[str]:
    address = "tcp:0:interface=127.0.0.1"
    return ["--dev", f"--data-dir={directory / 'master'}", f"--http={address}", f"--control={address}"]


def create_key(url: str) -> str:
    """Create an API key of USER, and return its secret."""
    api = ApiClient(url, user=USER, password=USER)
    return api.post(views.CreatedKey, "keys", body=views.NewKey("user", "bench")).secret


async def _fill(robots: Control, key: str, size: Size) -> None:
    """Log the robots in, and create their environments, interfaces and connections."""
    numbers, tags = range(size.robots), range(size.each)

    def execute(number: int, command: m.Command) -> Callable[[], Awaitable[Any]]:
        async def call() -> None:
            (await robots.call(Execute.of(f"{USER}/robot{number}", command))).raise_first_error()

        return call

    def login(number: int) -> Callable[[], Awaitable[Any]]:
        return lambda: robots.call(Login(USER, f"robot{number}", key))

    await _all(login(n) for n in numbers)
    await _all(execute(n, m.CreateContainer(f"brain{n}")) for n in numbers)
    await _all(
        execute(n, m.AddInterface(f"{owner}{n}", f"i{tag}", kind, TYPE, f"/t{tag}"))
        for n in numbers
        for owner, kind in SIDES
        for tag in tags
    )
    await _all(execute(n, m.Connect(f"robot{n}/i{tag}", f"brain{n}/i{tag}")) for n in numbers for tag in tags[1:])


async def _all(work: Iterable[Callable[[], Awaitable[Any]]]) -> None:
    """Run calls, MAX_CONCURRENT at a time."""
    gate = asyncio.Semaphore(MAX_CONCURRENT)

    async def one(each: Callable[[], Awaitable[Any]]) -> None:
        async with gate:
            await each()

    await asyncio.gather(*map(one, work))
