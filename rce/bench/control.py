"""Benchmark of the control plane: commands of one robot and of many at once, and logins, on a running platform.

Commands are those of the client library, one after the other, and frames with many items over bare sockets. Logins use
bare sockets, since a client library takes as much time as the platform. Beside them, in the same run: a round trip of
bare Perspective Broker, and a bare transaction of the database.
"""

from __future__ import annotations

import asyncio
import secrets
import statistics
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import sqlalchemy as sa
from msgspec import Struct, field
from twisted.internet import endpoints
from twisted.internet.base import ReactorBase
from twisted.spread import pb

from rce.api.client import ApiClient
from rce.bench.floors import server
from rce.bench.report import MILLI, aligned, machine
from rce.bench.statistics import percentile
from rce.bench.traffic.login import until_logged_out
from rce.bench.traffic.socket import BareRobot, connect
from rce.client import Robot
from rce.client.address import Address, password_digest
from rce.control.connection import disable_nagle

TYPE = "std_msgs/String"
NODE = ("rce_demo", "echo")
NODES = 3  # of each environment: each is a process
FLOOR_SAMPLES = 300
Work = Callable[[], Awaitable[object]]


class Phase(Struct):
    """Operations of one kind.

    Attributes:
        robots: Number of robots that worked at once; 0 for a lower bound.
        kind: What was done.
        elapsed: Seconds from the first operation to the end of the last.
        seconds: Time of each operation.
        items: Number of things that each operation adds or removes.
    """

    robots: int
    kind: str
    elapsed: float = 0.0
    seconds: list[float] = field(default_factory=list)
    items: int = 1

    @property
    def number(self) -> int:
        """Return the number of things that were added or removed."""
        return len(self.seconds) * self.items

    @property
    def each(self) -> float:
        """Return the seconds of the platform's time that each of them takes."""
        return self.elapsed / self.number


class Credentials(Struct, frozen=True):
    """Credentials of the robots: the platform's URL, a user with its password, and an API key of that user."""

    url: str
    user: str
    password: str
    key: str


async def measure(credentials: Credentials, crowds: Sequence[int], count: int) -> list[Phase]:
    """Measure all kinds of operations.

    Args:
        credentials: Credentials of the robots.
        crowds: Numbers of robots that work at once; one crowd is measured after the other.
        count: Number of interfaces and of connections of each robot.
    """
    phases: list[Phase] = []
    url = await Address(credentials.url, credentials.user, "bench", key=credentials.key).locate()
    for size in crowds:
        phases += await _logins(url, credentials, size, count)
        phases += await _commands(credentials, size, count)
        phases += await _frames(url, credentials, size, count)
    return phases


async def _logins(url: str, credentials: Credentials, size: int, count: int) -> list[Phase]:
    """Log in and out, each time with another robotID."""
    phases: list[Phase] = []
    api = ApiClient(credentials.url, user=credentials.user, password=credentials.password)
    secrets_of = {
        "log in by password": {"password": password_digest(credentials.password)},
        "log in by key": {"key": credentials.key},
    }
    for kind, secret in secrets_of.items():
        robots: list[BareRobot] = []

        async def login(secret: dict[str, str] = secret, robots: list[BareRobot] = robots) -> None:
            robots.append(await _bare_robot(url, credentials.user, secret))

        phases.append(await _phase(size, kind, [[login] * count for _ in range(size)]))
        for robot in robots:
            robot.socket.close()
        await until_logged_out(api, {robot.name for robot in robots})
    return phases


async def _bare_robot(url: str, user: str, secret: dict[str, str]) -> BareRobot:
    robot = BareRobot(f"bench_{secrets.token_hex(5)}")
    query = urlencode({"userID": user, "robotID": robot.name, "features": "ack", **secret})
    robot.socket = await connect(url, query, robot.received)
    return robot


async def _frames(url: str, credentials: Credentials, size: int, count: int) -> list[Phase]:
    """Add and remove `count` interfaces and connections of each robot, in one frame each."""
    robots = [await _bare_robot(url, credentials.user, {"key": credentials.key}) for _ in range(size)]
    frames: dict[str, Callable[[str], tuple[str, str, list[dict[str, str]]]]] = {
        "add interfaces": lambda robot: ("CN", "addInterfaces", [*map(_added, _tags(robot, 2 * count))]),
        "connect": lambda robot: ("CX", "connect", _pairs(robot, count)),
        "disconnect": lambda robot: ("CX", "disconnect", _pairs(robot, count)),
        "remove interfaces": lambda robot: ("CN", "removeInterfaces", _tags(robot, 2 * count)),
    }
    phases = []
    for kind, frame in frames.items():
        items = len(frame("")[2])
        works = [[_later(_send, robot, *frame(robot.name))] for robot in robots]
        phases.append(await _phase(size, f"{kind}, {items} a frame", works, items))
    for robot in robots:
        robot.socket.close()
    return phases


async def _send(robot: BareRobot, kind: str, name: str, items: list[dict[str, str]]) -> None:
    await robot.command(kind, {name: items})


def _tags(robot: str, count: int) -> list[dict[str, str]]:
    return [{"endpointTag": robot, "interfaceTag": f"i{index}"} for index in range(count)]


def _added(interface: dict[str, str]) -> dict[str, str]:
    """Return the data of a new interface: those with an even number send, the others receive."""
    sends = int(interface["interfaceTag"][1:]) % 2 == 0
    return interface | {"interfaceType": f"{'Subscriber' if sends else 'Publisher'}Converter", "className": TYPE}


def _pairs(robot: str, count: int) -> list[dict[str, str]]:
    return [{"tagA": f"{robot}/i{2 * index}", "tagB": f"{robot}/i{2 * index + 1}"} for index in range(count)]


async def _commands(credentials: Credentials, size: int, count: int) -> list[Phase]:
    """Create environments, nodes, interfaces and connections, and remove them in the reverse order."""
    async with AsyncExitStack() as stack:
        robots = [await stack.enter_async_context(_robot(credentials)) for _ in range(size)]
        steps: list[tuple[str, list[list[Work]]]] = [
            (kind, [works(robot, number) for number, robot in enumerate(robots)])
            for kind, works in _operations(count).items()
        ]
        return [await _phase(size, kind, works) for kind, works in steps]


def _operations(count: int) -> dict[str, Callable[[Robot, int], list[Work]]]:
    """Return the operations of one robot by their kinds, in their order."""
    run = secrets.token_hex(3)

    def brain(number: int) -> str:
        return f"bench_{run}_{number}"

    def ends(robot: Robot, number: int, index: int) -> tuple[str, str]:
        return f"{robot.name}/i{index}", f"{brain(number)}/i{index}"

    def nodes(what: Callable[[Robot, str, str], Awaitable[None]]) -> Callable[[Robot, int], list[Work]]:
        return lambda robot, n: [_later(what, robot, brain(n), f"node{index}") for index in range(NODES)]

    def interfaces(what: Callable[[Robot, str, str, str], Awaitable[None]]) -> Callable[[Robot, int], list[Work]]:
        return lambda robot, n: [
            _later(what, robot, endpoint, f"i{index}", kind)
            for index in range(count)
            for endpoint, kind in ((robot.name, "SubscriberConverter"), (brain(n), "PublisherInterface"))
        ]

    def connections(what: Callable[[Robot, str, str], Awaitable[None]]) -> Callable[[Robot, int], list[Work]]:
        return lambda robot, n: [_later(what, robot, *ends(robot, n, index)) for index in range(count)]

    return {
        "create environment": lambda robot, n: [_later(Robot.create_environment, robot, brain(n), restart="no")],
        "add node": nodes(lambda robot, where, tag: robot.add_node(where, tag, *NODE)),
        "add interface": interfaces(_add_interface),
        "connect": connections(Robot.connect),
        "disconnect": connections(Robot.disconnect),
        "remove interface": interfaces(lambda robot, endpoint, tag, _kind: robot.remove_interface(endpoint, tag)),
        "remove node": nodes(Robot.remove_node),
        "destroy environment": lambda robot, n: [_later(Robot.destroy_environment, robot, brain(n))],
    }


async def _add_interface(robot: Robot, endpoint: str, tag: str, kind: Any) -> None:
    await robot.add_interface(endpoint, tag, kind, TYPE, addr="" if endpoint == robot.name else f"/{tag}")


def _later(function: Callable[..., Awaitable[object]], *arguments: Any, **options: Any) -> Work:
    return lambda: function(*arguments, **options)


def _robot(credentials: Credentials) -> Robot:
    return Robot(credentials.url, user=credentials.user, robot=f"bench_{secrets.token_hex(5)}", key=credentials.key)


async def _phase(robots: int, kind: str, works: Iterable[Sequence[Work]], items: int = 1) -> Phase:
    """Do the works of all robots at once, those of one robot one after the other."""
    phase = Phase(robots, kind, items=items)

    async def one(own: Sequence[Work]) -> None:
        for work in own:
            began = time.perf_counter()
            await work()
            phase.seconds.append(time.perf_counter() - began)

    began = time.perf_counter()
    await asyncio.gather(*map(one, works))
    phase.elapsed = time.perf_counter() - began
    return phase


async def floors(reactor: ReactorBase, directory: Path) -> list[Phase]:
    """Measure a bare round trip and a bare transaction.

    Args:
        reactor: Twisted's reactor.
        directory: Directory on the disk to write to.
    """
    async with _broker(reactor) as call, _database(directory) as commit:
        return [
            await _phase(0, "bare Perspective Broker call", [[call] * FLOOR_SAMPLES]),
            await _phase(0, "bare SQLite transaction", [[commit] * FLOOR_SAMPLES]),
        ]


@asynccontextmanager
async def _broker(reactor: ReactorBase) -> AsyncIterator[Work]:
    """Yield a call to an object in another process, which returns its argument."""
    loop = asyncio.get_running_loop()
    async with server("rce.bench.broker_echo") as port:
        factory = pb.PBClientFactory()
        endpoint = endpoints.TCP4ClientEndpoint(reactor, "127.0.0.1", port)
        broker = await endpoint.connect(factory).asFuture(loop)  # type: ignore[arg-type]  # zope's interface
        disable_nagle(broker.transport)
        root = await factory.getRootObject().asFuture(loop)
        try:
            yield lambda: root.callRemote("echo", b"x" * 100).asFuture(loop)
        finally:
            factory.disconnect()


@asynccontextmanager
async def _database(directory: Path) -> AsyncIterator[Work]:
    """Yield a transaction of one row in the database of the Master's kind: SQLite with a write-ahead log."""
    engine = sa.create_engine(f"sqlite:///{directory / 'floor.db'}")

    def write() -> None:
        with engine.begin() as connection:
            connection.execute(sa.text("insert into floor values (:value)"), {"value": "x" * 100})

    def prepare() -> None:
        with engine.begin() as connection:
            connection.execute(sa.text("create table floor (value text)"))
            connection.execute(sa.text("pragma journal_mode=wal"))

    await asyncio.to_thread(prepare)
    try:
        yield lambda: asyncio.to_thread(write)
    finally:
        engine.dispose()


def as_text(phases: Sequence[Phase]) -> str:
    """Return a table of medians, 99th percentiles and rates."""
    host = machine()
    title = f"Control plane; {host['processor']}, {host['cores']} cores, load {host['load']:.1f}"
    rows = [["", "robots", "number", "median ms", "p99 ms", "per second"], *map(_row, phases)]
    rows = [[row[0].ljust(max(len(each[0]) for each in rows)), *row[1:]] for row in rows]
    return "\n".join([title, "", *aligned(rows)])


def _row(phase: Phase) -> list[str]:
    median, tail = statistics.median(phase.seconds), percentile(phase.seconds, 99)
    return [
        phase.kind,
        str(phase.robots or ""),
        str(phase.number),
        f"{median * MILLI:.2f}",
        f"{tail * MILLI:.2f}",
        f"{1 / phase.each:.0f}" if phase.each < 1 else f"{1 / phase.each:.2f}",
    ]


def as_data(phases: Sequence[Phase]) -> dict[str, Any]:
    """Return all samples in seconds, for JSON."""
    kinds = [
        {
            "robots": each.robots,
            "kind": each.kind,
            "items": each.items,
            "elapsed": each.elapsed,
            "seconds": each.seconds,
        }
        for each in phases
    ]
    return {"machine": machine(), "phases": kinds}
