"""Costs of a Master by robots and environments: `python -m tests.support.master.trial_capacity`.

A real Master with its database; the processes around it are in memory here and answer at once. docs/capacity.md has the
figures.
"""

from __future__ import annotations

import asyncio
import secrets
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from twisted.internet.base import ReactorBase

from master.access.users import Users
from master.storage.store import Store
from rce import __version__
from rce.bench.hollow import Hollow, done
from rce.control.calls.call import Nothing
from rce.control.calls.environments import KeepEnvironments, SetRelays, StartEnvironment, StopEnvironment
from rce.control.calls.joining import Hello
from rce.control.calls.robots import Execute, Login
from rce.control.client import connect
from rce.control.connection import Control, Handlers
from rce.process import loop
from rce.process.ready import Ready, parse
from rce.protocol import messages as m

USERS, ROBOTS, ENVIRONMENTS = 20, 400, 100
AT_ONCE = 20


class Around:
    """Processes around a Master: a Robot endpoint, a task set, and environments that join when started."""

    def __init__(self, reactor: ReactorBase, address: str) -> None:
        self._reactor = reactor
        self._address = address
        self.environments: dict[str, Control] = {}
        self.robots: Control

    def handlers(self) -> Handlers:
        """Return the handlers of a process."""
        handlers = Hollow().handlers()
        for kind in (StopEnvironment, KeepEnvironments, SetRelays):
            handlers.on(kind, done)
        handlers.on(StartEnvironment, self._start)
        return handlers

    async def join(self, role: str, name: str, token: str, **hello: Any) -> Control:
        said = Hello(role, name, token, __version__, incarnation=secrets.token_hex(4), host="here", **hello)
        control, _ = await connect(self._reactor, self._address, said, self.handlers())
        return control

    async def _start(self, call: StartEnvironment) -> Nothing:
        spec = call.environment
        control = await self.join("environment", spec.name, spec.token)
        self.environments[spec.name] = control
        return Nothing()


@asynccontextmanager
async def master(directory: Path, tokens: str) -> AsyncIterator[tuple[asyncio.subprocess.Process, Ready]]:
    words = [f"--data-dir={directory}", "--http=tcp:0", "--control=tcp:0:interface=127.0.0.1", f"--tokens={tokens}"]
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-P", "-m", "master", *words),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    assert process.stdout is not None
    while (ready := parse(await process.stdout.readline())) is None:
        pass
    try:
        yield process, ready
    finally:
        process.terminate()
        await process.wait()


def used(pid: int) -> tuple[float, float]:
    """Resident memory in MB and processor time in seconds."""
    status = Path(f"/proc/{pid}/status").read_text()
    resident = int(status.split("VmRSS:")[1].split()[0]) / 1024
    ticks = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].split()
    return resident, (int(ticks[11]) + int(ticks[12])) / 100


async def all_of(work: Iterable[Callable[[], Awaitable[Any]]]) -> None:
    """A few at a time."""
    gate = asyncio.Semaphore(AT_ONCE)

    async def one(each: Callable[[], Awaitable[Any]]) -> None:
        async with gate:
            await each()

    await asyncio.gather(*map(one, work))


async def trial(reactor: ReactorBase) -> None:
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        store = Store(f"sqlite:///{directory / 'master.db'}")
        await store.open()
        users = Users(store)
        for number in range(USERS):
            await users.add(f"u{number}", "secret")
        keys = [(await users.keys.add(f"u{number}"))[0] for number in range(USERS)]
        await store.close()
        async with master(directory, "robot:west:t1,container:m1:t2") as (process, ready):
            around = Around(reactor, ready.control)
            robots = await around.join("robot", "west", "t1", url="ws://:1/", addresses=["unix:/w"])
            await around.join("container", "m1", "t2", capacity=10 * ENVIRONMENTS)

            async def phase(title: str, count: int, work: Iterable[Callable[[], Awaitable[Any]]]) -> None:
                memory, cpu = used(process.pid)
                began = time.monotonic()
                await all_of(work)
                took = time.monotonic() - began
                more, spent = (after - before for after, before in zip(used(process.pid), (memory, cpu), strict=True))
                print(
                    f"{title:28} {count / took:7.0f} a second, {1000 * spent / count:6.2f} ms of a core and "
                    f"{1000 * more / count:6.1f} kB each",
                    flush=True,
                )

            def execute(number: int, command: m.Command) -> Callable[[], Awaitable[Any]]:
                async def call() -> None:
                    (await robots.call(Execute.of(f"u{number % USERS}/r{number}", command))).raise_first_error()

                return call

            def login(number: int) -> Callable[[], Awaitable[Any]]:
                return lambda: robots.call(Login(f"u{number % USERS}", f"r{number}", keys[number % USERS]))

            def interface(number: int, owner: str, kind: str) -> Callable[[], Awaitable[Any]]:
                return execute(number, m.AddInterface(f"{owner}{number}", "i", kind, "std_msgs/String"))

            def each(command: Callable[[int], m.Command]) -> list[Callable[[], Awaitable[Any]]]:
                return [execute(number, command(number)) for number in range(ENVIRONMENTS)]

            print(f"at the start {used(process.pid)[0]:.0f} MB")
            await phase("robots log in", ROBOTS, map(login, range(ROBOTS)))
            await phase("environments (CC to ack)", ENVIRONMENTS, each(lambda n: m.CreateContainer(f"e{n}")))
            sides = [("r", "SubscriberConverter"), ("e", "PublisherInterface")]
            both = [interface(n, *side) for side in sides for n in range(ENVIRONMENTS)]
            await phase("interfaces", len(both), both)
            await phase("connections", ENVIRONMENTS, each(lambda n: m.Connect(f"r{n}/i", f"e{n}/i")))
            before = used(process.pid)[1]
            await asyncio.sleep(20)
            idle = (used(process.pid)[1] - before) / 20
            print(f"idle, {ENVIRONMENTS + 2} control connections: {100 * idle:.1f} % of a core")
            await phase("environments go", ENVIRONMENTS, each(lambda n: m.DestroyContainer(f"e{n}")))


if __name__ == "__main__":
    sys.exit(loop.run(trial))
