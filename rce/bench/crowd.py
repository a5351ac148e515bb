"""A Master with a crowd around it: robots with an environment each, in traffic, of which only the Master is real.

The Robot endpoint is in this process, the environments are those of a task set with the fake engine (the program
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

from rce import messages as m
from rce import views
from rce.api import Api
from rce.bench.hollow import join
from rce.calls.robots import Execute, Login
from rce.control import Control
from rce.ready import Ready
from rce.up import Part

USER = "testUser"  # of a Master for development
AT_ONCE = 20
TYPE = "std_msgs/String"
SIDES = (("robot", "SubscriberConverter"), ("brain", "PublisherInterface"))


class Size(NamedTuple):
    """`each`: interfaces of each robot and of each environment, of which all but one are connected."""

    robots: int
    each: int

    @property
    def interfaces(self) -> int:
        return 2 * self.robots * self.each


class Crowded(NamedTuple):
    """The Master: its entry, the id of its process, and an API key of USER."""

    url: str
    pid: int
    key: str


@asynccontextmanager
async def crowd(reactor: ReactorBase, directory: Path, size: Size, log: IO[str]) -> AsyncIterator[Crowded]:
    """Keeps what it has in `directory`, and its logs in `log`; gone with the context. StartFailed."""
    tokens = {"robot": secrets.token_hex(32), "container": secrets.token_hex(32)}
    allowed = f"robot:west:{tokens['robot']},container:hollow:{tokens['container']}"
    master = Part("master", lambda: _master(directory), {"RCE_TOKENS": allowed}, log)
    ready: Ready | None = None

    def machine_words() -> list[str]:
        assert ready is not None
        return [f"--data-dir={directory / 'container'}", f"--master={ready.control}", f"--size={size.robots}"]

    machine = Part("hollow-machine", machine_words, {"RCE_TOKEN": tokens["container"]}, log)
    try:
        ready = await master.start()
        await machine.start()
        robots = await join(reactor, ready.control, "robot", "west", tokens["robot"], "ws://127.0.0.1:1/")
        try:
            key = await asyncio.to_thread(_key, ready.url)
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


def _key(url: str) -> str:
    api = Api(url, user=USER, password=USER)
    return api.post(views.MadeKey, "keys", body=views.NewKey("user", "bench")).secret


async def _fill(robots: Control, key: str, size: Size) -> None:
    numbers, tags = range(size.robots), range(size.each)

    def execute(number: int, command: m.Command) -> Callable[[], Awaitable[Any]]:
        return lambda: robots.call(Execute.of(f"{USER}/robot{number}", command))

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
    """A few at a time."""
    gate = asyncio.Semaphore(AT_ONCE)

    async def one(each: Callable[[], Awaitable[Any]]) -> None:
        async with gate:
            await each()

    await asyncio.gather(*map(one, work))
