"""Crowd of robots, each of which sends messages to the next one."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import psutil
from msgspec import Struct, field

from rce.api.client import ApiClient
from rce.api.http import EntryClient, basic
from rce.api.joining import sibling_name
from rce.bench.traffic.login import Login, until_logged_out
from rce.bench.traffic.socket import BareRobot, connect
from rce.errors import RceError

TYPE = "std_msgs/String"
TOGETHER = 50  # robots that log in at the same time
STAMP = 20  # digits of the time at the begin of a message, in ns
TICK = 0.002  # seconds; what is due is sent once in this time
REST = 2.0  # seconds for the last messages
PATIENCE = 300.0  # seconds for all logins, or for all connections
BEGIN = re.compile(rb'"msg": ?{"data": ?"')


class Crowd(Struct):
    """Robots that sent each other messages, each to the next one.

    Attributes:
        robots: Number of robots.
        processes: Number of processes of the Robot endpoint.
        memory: Memory of an idle robot at the endpoint, in bytes.
        sent: Number of messages.
        received: Number of messages that arrived.
        latencies: Seconds from one robot to the other.
        endpoint: Processor time of the endpoint, in cores.
        bench: Processor time of the robots, in cores.
    """

    robots: int
    processes: int
    memory: float = 0.0
    sent: int = 0
    received: int = 0
    latencies: list[float] = field(default_factory=list)
    endpoint: float = 0.0
    bench: float = 0.0


class Cost:
    """Processor time and memory of the Robot endpoint, whose processes are found by its directory."""

    def __init__(self, directory: Path) -> None:
        self._own = psutil.Process()
        self._processes = [
            each
            for each in psutil.process_iter(["cmdline"])
            if "endpoints.robot" in (words := " ".join(each.info["cmdline"] or [])) and str(directory) in words
        ]

    def memory(self) -> int:
        """Return the memory that belongs to the endpoint alone, in bytes."""
        return sum(each.memory_full_info().uss for each in self._processes)

    def seconds(self) -> tuple[float, float]:
        """Return the processor time of the endpoint and of this process."""
        return sum(map(_seconds, self._processes)), _seconds(self._own)


def _seconds(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


class Load(NamedTuple):
    """Load of a crowd.

    Attributes:
        robots: Number of robots.
        rate: Messages of each robot in a second.
        size: Bytes of the string in a message.
        seconds: Duration.
    """

    robots: int
    rate: float
    size: int
    seconds: float


async def until_joined(url: str, processes: int) -> None:
    """Wait until all processes of the Robot endpoint have joined the Master of a platform with `--dev`."""
    entry = EntryClient(url, basic("admin", "admin"))
    names = ["robot-1", *(sibling_name("robot-1", number) for number in range(2, processes + 1))]
    async with asyncio.timeout(PATIENCE):
        for name in names:
            while not await asyncio.to_thread(_is_there, entry, f"metrics/{name}"):  # noqa: ASYNC110
                await asyncio.sleep(0.1)


def _is_there(entry: EntryClient, path: str) -> bool:
    try:
        entry.open("GET", path).close()
    except RceError:
        return False
    return True


async def crowd(login: Login, directory: Path, load: Load, processes: int) -> Crowd:
    """Let robots send each other messages, each to the next one.

    Args:
        login: Where and as whom they log in.
        directory: Data of the platform.
        load: What they do.
        processes: Number of processes of the Robot endpoint, which have joined.
    """
    result, cost = Crowd(load.robots, processes), Cost(directory)
    empty = cost.memory()
    members = await _log_in(login, load.robots, result)
    result.memory = (cost.memory() - empty) / load.robots
    try:
        await _wire(members)
        before = cost.seconds()
        elapsed = await _send(members, load, result)
        after = cost.seconds()
        result.endpoint, result.bench = ((now - then) / elapsed for now, then in zip(after, before, strict=True))
        await _rest(result)
    finally:
        for member in members:
            member.socket.close()
    await until_logged_out(ApiClient(login.url, key=login.key), {member.name for member in members})
    return result


class Member(BareRobot):
    """Robot of a crowd."""

    def __init__(self, number: int, result: Crowd) -> None:
        super().__init__(f"crowd{number}")
        self._result = result

    def received(self, text: bytes) -> None:
        """Take a message, or the answer to a command."""
        begin = BEGIN.search(text)
        if begin is None:
            super().received(text)
            return
        sent = int(text[begin.end() : begin.end() + STAMP])
        self._result.latencies.append((time.perf_counter_ns() - sent) / 1e9)
        self._result.received += 1


async def _log_in(login: Login, robots: int, result: Crowd) -> list[Member]:
    members = [Member(number, result) for number in range(robots)]
    places = asyncio.Semaphore(TOGETHER)
    url = await login.locate()

    async def one(member: Member) -> None:
        async with places:
            member.socket = await connect(url, login.query(member.name, "ack"), member.received)

    async with asyncio.timeout(PATIENCE):
        await asyncio.gather(*map(one, members))
    return members


async def _wire(members: Sequence[Member]) -> None:
    """Add the interfaces of all robots, then connect each robot with the next one."""
    places = asyncio.Semaphore(TOGETHER)

    async def add(member: Member) -> None:
        interfaces = [
            {"endpointTag": member.name, "interfaceTag": tag, "interfaceType": kind, "className": TYPE}
            for tag, kind in (("out", "SubscriberConverter"), ("in", "PublisherConverter"))
        ]
        async with places:
            await member.command("CN", {"addInterfaces": interfaces})

    async def connect_with(member: Member, other: Member) -> None:
        async with places:
            await member.command("CX", {"connect": [{"tagA": f"{member.name}/out", "tagB": f"{other.name}/in"}]})

    async with asyncio.timeout(PATIENCE):
        await asyncio.gather(*map(add, members))
        await asyncio.gather(*map(connect_with, members, [*members[1:], members[0]]))


async def _send(members: Sequence[Member], load: Load, result: Crowd) -> float:
    """Send the messages, evenly distributed over the time; return the seconds that it took."""
    start = b'{"type":"DM","data":{"iTag":"out","type":"%s","msgID":"nil","msg":{"data":"' % TYPE.encode()
    end = b"x" * (load.size - STAMP) + b'"}}}'
    total = int(load.rate * load.seconds * len(members))
    began = time.perf_counter()
    while result.sent < total:
        due = min(total, int((time.perf_counter() - began) * load.rate * len(members)))
        for number in range(result.sent, due):
            stamp = b"%0*d" % (STAMP, time.perf_counter_ns())
            members[number % len(members)].socket.send(start + stamp + end)
        result.sent = due
        await asyncio.sleep(TICK)
    return time.perf_counter() - began


async def _rest(result: Crowd) -> None:
    """Wait for the last messages."""
    with_rest = time.perf_counter() + REST
    while result.received < result.sent and time.perf_counter() < with_rest:  # noqa: ASYNC110  # a count, no event
        await asyncio.sleep(TICK)
