"""Benchmark of recordings: the rate that one takes with its memory, and the intervals at which one is played."""

from __future__ import annotations

import asyncio
import itertools
import random
import time
from pathlib import Path
from typing import Any

import psutil
from msgspec import Struct, to_builtins

from rce.bag.player import Player
from rce.bag.reader import Recorded, read, summarize
from rce.bag.writer import MEGABYTE, BagWriter, Limits, Topic
from rce.bench.nodes import Place
from rce.bench.report import aligned, machine
from rce.bench.resources import Series, trend
from rce.bench.statistics import percentile
from rce.client import Publisher
from rce.client.recordings import RecordingsClient

MESSAGE = MEGABYTE  # bytes of a recorded message, of which half can be compressed
VARIANTS = 16  # different messages
FILE = 500 * MEGABYTE  # bytes of a file, after which the next one begins
SETTLING = 3.0  # seconds in which the recorder finds the topics
MILLI = 1e3
STRING = "std_msgs/msg/String"
PLAYED = {"/bench/fast": (200.0, 100), "/bench/slow": (30.0, 100_000)}
"""Messages a second, and bytes of each, of the topics that are played."""


class Recording(Struct):
    """Result of recording.

    Attributes:
        rate: Bytes of messages a second that were recorded.
        dropped: Messages that were dropped.
        cores: Processor time by time.
        size: Bytes of all files.
        memory: Memory of the process in bytes, each second.
        growth: Growth of the memory after the warm-up, as a share of its mean.
    """

    rate: float
    dropped: int
    cores: float
    size: int
    memory: list[float]
    growth: float


class Replay(Struct):
    """Result of playing.

    Attributes:
        messages: Number of messages.
        same: Whether the messages of each topic arrived with the same bytes in the same order.
        errors: Differences of the intervals between two messages of a topic, in seconds.
    """

    messages: int
    same: bool
    errors: list[float]


async def record(path: Path, rate: float, seconds: float) -> Recording:
    """Record messages at a rate in bytes a second.

    Each file is removed when the next one has begun, so that a minute does not need the disk for all of them.
    """
    filler = random.Random(1)
    messages = [filler.randbytes(MESSAGE // 2) + bytes(MESSAGE // 2) for _ in range(VARIANTS)]
    topic = Topic("/bench", "std_msgs/msg/ByteMultiArray", "byte[] data\n")
    process = psutil.Process()
    writer = BagWriter(path, Limits(FILE))
    memory, files = Series(), _Files(writer)
    began, busy = time.monotonic(), process.cpu_times()
    sampled = 0.0
    try:
        for number in range(int(rate * seconds / MESSAGE)):
            due = began + number * MESSAGE / rate
            await asyncio.sleep(max(0.0, due - time.monotonic()))
            writer.put(topic, messages[number % VARIANTS], time.time_ns())
            if (passed := time.monotonic() - began) >= sampled + 1:
                sampled = passed
                memory.add(passed, memory=process.memory_full_info().uss)
                files.remove_complete()
        await asyncio.to_thread(writer.close, {})
        passed, after = time.monotonic() - began, process.cpu_times()
    finally:
        files.remove_all()
    cores = (after.user + after.system - busy.user - busy.system) / passed
    figures = memory.figures.get("memory", [])
    growth = trend(memory, "memory").growth if len(figures) > 2 else 0.0  # a line needs points
    return Recording(writer.messages * MESSAGE / passed, writer.dropped.total(), cores, files.size, figures, growth)


class _Files:
    """Files of a recording, and the bytes of those that were removed."""

    def __init__(self, writer: BagWriter) -> None:
        self.size = 0
        self._writer = writer
        self._removed = 0

    def remove_complete(self) -> None:
        self._remove(len(self._writer.paths) - 1)

    def remove_all(self) -> None:
        self._remove(len(self._writer.paths))

    def _remove(self, until: int) -> None:
        for path in self._writer.paths[self._removed : until]:
            self.size += path.stat().st_size
            path.unlink()
        self._removed = max(self._removed, until)


async def replay(place: Place, directory: Path, seconds: float) -> Replay:
    """Play a recording into the environment of a place, record it there in the cloud, and compare the two."""
    source, copy = directory / "source.mcap", directory / "copy.mcap"
    await asyncio.to_thread(_write, source, seconds)
    publishers: dict[str, Publisher] = {}
    for name in PLAYED:
        publishers[name] = await place.environment.publisher(name, STRING, raw=True)
    await place.environment.add_recorder("bench", *PLAYED)
    await asyncio.sleep(SETTLING)

    async def publish(each: Recorded) -> None:
        await publishers[each.topic].publish(each.cdr)

    await Player(source, summarize(source), publish).run(until_end=True)
    await asyncio.sleep(SETTLING)
    await place.environment.remove_recorder("bench")
    await asyncio.to_thread(_fetch, place, copy)
    return compare(source, copy)


def _fetch(place: Place, copy: Path) -> None:
    address = place.address
    assert address is not None
    client = RecordingsClient(address.url, user=address.user, password=address.password, key=address.key)
    for each in client.pages("", place.environment.tag).items:
        client.fetch(f"{each.machine}/{each.recording}", copy)
        client.remove(f"{each.machine}/{each.recording}")


def _write(path: Path, seconds: float) -> None:
    """Write a recording with intervals that vary."""
    writer, source = BagWriter(path), random.Random(1)
    began = time.time_ns()
    times = sorted(
        (began + int(1e9 * (number + source.uniform(0, 0.5)) / rate), name, number)
        for name, (rate, _) in PLAYED.items()
        for number in range(int(rate * seconds))
    )
    for at, name, number in times:
        text = f"{number:08}".encode() * (PLAYED[name][1] // 8) + b"\0"
        writer.put(Topic(name, STRING, "string data\n"), b"\0\1\0\0" + len(text).to_bytes(4, "little") + text, at)
    writer.close({})


def compare(source: Path, copy: Path) -> Replay:
    """Compare the messages of two recordings by topic, and the intervals between them."""
    one, other = _by_topic(source), _by_topic(copy)
    same = {name: [cdr for _, cdr in found] for name, found in one.items()} == {
        name: [cdr for _, cdr in found] for name, found in other.items()
    }
    errors: list[float] = []
    for name, found in one.items():
        intervals = zip(itertools.pairwise(found), itertools.pairwise(other.get(name, [])), strict=False)
        errors += [abs((b[0] - a[0]) - (d[0] - c[0])) / 1e9 for (a, b), (c, d) in intervals]
    return Replay(sum(map(len, one.values())), same, errors)


def _by_topic(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    found: dict[str, list[tuple[int, bytes]]] = {}
    for each in read(path):
        found.setdefault(each.topic, []).append((each.time, each.cdr))
    return found


def as_data(recording: Recording, replayed: Replay) -> dict[str, Any]:
    """Return all samples for JSON."""
    data: dict[str, Any] = to_builtins({"machine": machine(), "recording": recording, "replay": replayed})
    return data


def as_text(recording: Recording, replayed: Replay) -> str:
    """Return the figures as text."""
    memory = recording.memory or [0.0]
    rows = [
        ["recorded", f"{recording.rate / MEGABYTE:.0f} MB/s", f"{recording.dropped} dropped"],
        ["memory, MB", f"{memory[0] / MEGABYTE:.0f} to {memory[-1] / MEGABYTE:.0f}", f"{recording.growth:+.1%}"],
        ["processors", f"{recording.cores:.2f} cores", f"{recording.size / MEGABYTE:.0f} MB of files"],
        ["played", f"{replayed.messages} messages", "same bytes" if replayed.same else "DIFFERENT"],
    ]
    if replayed.errors:
        figures = (percentile(replayed.errors, 50), percentile(replayed.errors, 99), max(replayed.errors))
        rows.append(["intervals, ms", "p50 {:.2f}, p99 {:.2f}".format(*(each * MILLI for each in figures)), ""])
        rows[-1][2] = f"most {figures[2] * MILLI:.1f}"
    return "\n".join(aligned(rows))
