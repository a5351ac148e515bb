"""Soak: the visitors, and the report."""

from __future__ import annotations

import asyncio
import json
import time
from typing import Any, cast

import pytest

pytest.importorskip("psutil", reason="needs the extra `bench`")

from rce.bench import soak
from rce.bench.resources import Observer, Series
from rce.bench.soak import MESSAGES, Result, Soak
from rce.client import Robot
from rce.errors import NotFound
from tests.support.bench import Topic


class FakeRobot:
    """Robot whose messages come back from the environment, each after one of another visitor."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.log: list[tuple[Any, ...]] = []
        self.back = Topic()
        self.out = Topic(lambda message: self.back.messages.extend(({"data": "another's"}, message)))
        self.out.close = self._close  # type: ignore[attr-defined]

    async def _close(self) -> None:
        self.log.append(("closed",))

    async def add_interface(self, owner: str, tag: str, kind: str, type_name: str, addr: str) -> None:
        self.log.append(("added", owner, tag, kind, addr))

    async def remove_interface(self, owner: str, tag: str) -> None:
        self.log.append(("removed", owner, tag))

    async def publisher(self, tag: str, type_name: str, to: str) -> Topic:
        return self.out

    async def subscriber(self, tag: str, type_name: str, to: str) -> Topic:
        return self.back


class FakeObserver:
    """Observer that counts its samples."""

    def __init__(self) -> None:
        self.restarts: list[str] = []
        self.series: dict[str, Series] = {}
        self.times: list[float] = []

    def sample(self, time: float) -> None:
        self.times.append(time)


async def test_visitor_receives_its_own_messages_and_removes_what_it_has_added() -> None:
    robot = FakeRobot("guest_1")
    await Soak("http://x/", "u", "p", lambda _: None)._talk(cast(Robot, robot), "lasting")
    assert len(robot.out.sent) == MESSAGES + 1
    added = {entry[2] for entry in robot.log if entry[0] == "added"}
    removed = {entry[2] for entry in robot.log if entry[0] == "removed"}
    assert added == removed == {"guest_1_pub", "guest_1_sub"}


async def test_visitors_come_at_the_rate_and_one_in_so_many_has_an_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen: list[tuple[str, str]] = []

    async def note(kind: str, name: str) -> None:
        seen.append((kind, name))
        if name == "gone_10":
            raise NotFound("robot 10 is away")

    made = Soak("http://x/", "u", "p", lambda _: None)
    monkeypatch.setattr(made, "_vanish", lambda name: note("vanishes", name))
    monkeypatch.setattr(made, "_bring_environment", lambda name: note("brings", name))

    class Visitor(FakeRobot):
        async def __aenter__(self) -> FakeRobot:
            await note("visits", self.name)
            return self

        async def __aexit__(self, *_: object) -> None:
            return

    monkeypatch.setattr(made, "robot", Visitor)
    await made._receive(time.monotonic(), 0.2, 60.0)
    names = {name: kind for kind, name in seen}
    assert [names[f"guest_{number}"] for number in (1, 2, 3, 4, 7, 8, 9)] == ["visits"] * 7
    assert (names["gone_5"], names["owner_6"]) == ("vanishes", "brings")
    assert made._failures == {"NotFound: robot N is away": 1}
    assert made.result.visits == len(seen) - 1


async def test_samples_are_reported_while_the_soak_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    reported: list[Result] = []
    monkeypatch.setattr(soak, "INTERVAL", 0.0)
    monkeypatch.setattr(soak, "REPORTED", 2)
    enough = asyncio.Event()

    def report(result: Result) -> None:
        reported.append(result)
        enough.set()

    observer = FakeObserver()
    sampling = asyncio.create_task(Soak("http://x/", "u", "p", report)._sample(cast(Observer, observer), 0.0))
    await asyncio.wait_for(enough.wait(), 20)
    sampling.cancel()
    assert len(observer.times) >= 2
    assert reported[0].seconds > 0


async def test_failure_to_sample_ends_the_soak(monkeypatch: pytest.MonkeyPatch) -> None:
    class Host(FakeRobot):
        async def __aenter__(self) -> Host:
            return self

        async def __aexit__(self, *_: object) -> None:
            return

        def environment(self, tag: str) -> Host:
            return self

        async def add_node(self, *words: str, **more: str) -> None:
            self.log.append(("node", *words))

    class BrokenObserver(FakeObserver):
        def sample(self, time: float) -> None:
            raise OSError("no such directory")

    monkeypatch.setattr(soak, "INTERVAL", 0.0)
    made = Soak("http://x/", "u", "p", lambda _: None)
    monkeypatch.setattr(made, "robot", Host)
    with pytest.raises(ExceptionGroup) as raised:
        await asyncio.wait_for(made.run(cast(Observer, BrokenObserver()), 3600.0, 0.001), 20)
    assert raised.group_contains(OSError, match="no such directory")


def result() -> Result:
    flat, growing = Series(), Series()
    for number in range(10):
        flat.add(10.0 * number, memory=5e6, tasks=3)
        growing.add(10.0 * number, database=1e6 * (1 + number))
    failures = {"TimedOut: late": 2}
    return Result(600.0, 100, 16, failures, ["Master"], {"Master": flat, "data": growing})


def test_table_says_what_grows() -> None:
    lines = soak.as_text(result()).splitlines()
    assert lines[0].startswith("100 visits in 10 min (16 with an environment), 2 failed; ")
    assert "  2 x TimedOut: late" in lines
    assert "  Master ended and was started again" in lines
    memory, tasks, database = lines[-3:]
    assert memory.split() == ["Master", "memory", "5.0", "MB", "5.0", "MB", "+0.0", "%", "+0.0", "MB", "flat"]
    assert tasks.endswith("flat")
    assert "+360.0 MB" in database
    assert database.endswith("grows more than 2 %")


def test_data_has_all_samples() -> None:
    data = json.loads(json.dumps(soak.as_data(result())))["soak"]
    assert data["series"]["Master"]["figures"]["tasks"] == [3] * 10
