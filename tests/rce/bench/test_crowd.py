"""The crowd of robots at a Master."""

from __future__ import annotations

import asyncio
from collections import Counter
from pathlib import Path
from typing import Any, ClassVar, cast

import pytest
from twisted.internet.base import ReactorBase

from rce.bench import crowd
from rce.bench.crowd import MAX_CONCURRENT, Size
from rce.control.calls.robots import Execute, Executed, Login
from rce.control.connection import Control
from rce.process.ready import Ready


class Master:
    """Master that records the calls of the robots, and how many are open at a time."""

    def __init__(self) -> None:
        self.calls: list[Any] = []
        self.most = 0
        self._open = 0

    async def call(self, call: Any) -> Executed:
        self._open += 1
        self.most = max(self.most, self._open)
        await asyncio.sleep(0)
        self._open -= 1
        self.calls.append(call)
        return Executed()

    def commands(self) -> list[Any]:
        return [each.unpack() for call in self.calls if isinstance(call, Execute) for each in call.commands]


def test_interfaces_are_counted_at_both_ends() -> None:
    assert Size(robots=20, each=5).interfaces == 200


async def test_crowd_has_an_environment_and_interfaces_for_each_robot_and_all_but_one_connected() -> None:
    master = Master()
    await crowd._fill(cast(Control, master), "rce_key", Size(3, 2))
    kinds = Counter(type(command).__name__ for command in master.commands())
    assert kinds == {"CreateContainer": 3, "AddInterface": 12, "Connect": 3}
    logins = [call for call in master.calls if isinstance(call, Login)]
    assert [(call.robot, call.secret) for call in logins] == [(f"robot{number}", "rce_key") for number in range(3)]
    connected = [(each.tagA, each.tagB) for each in master.commands() if type(each).__name__ == "Connect"]
    assert connected[0] == ("robot0/i1", "brain0/i1")


async def test_calls_are_made_some_at_a_time() -> None:
    master = Master()
    await crowd._fill(cast(Control, master), "rce_key", Size(MAX_CONCURRENT * 2, 1))
    assert master.most == MAX_CONCURRENT


class Program:
    """Program of a crowd; `log` has what was started and stopped."""

    log: ClassVar[list[str]] = []
    pid = 17

    def __init__(self, name: str, *arguments: object) -> None:
        self.name = name

    async def start(self) -> Any:
        self.log.append(f"start {self.name}")
        return Ready(self.name, "http://127.0.0.1:1/", "tcp:127.0.0.1:2")

    async def stop(self) -> None:
        self.log.append(f"stop {self.name}")


async def test_programs_are_stopped_if_robots_cannot_join(
    reactor: ReactorBase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def join(*arguments: object) -> Control:
        raise ConnectionError("refused")

    monkeypatch.setattr(crowd, "ManagedProcess", Program)
    monkeypatch.setattr(crowd, "join", join)
    monkeypatch.setattr(Program, "log", [])
    with pytest.raises(ConnectionError):
        async with crowd.crowd(reactor, tmp_path, Size(1, 1), cast(Any, None)):
            raise AssertionError("the crowd is there")
    assert Program.log == ["start master", "start hollow-machine", "stop hollow-machine", "stop master"]
