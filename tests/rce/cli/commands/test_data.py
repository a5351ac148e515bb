"""`topic`, `service` and `env shell`: lists, and what is left to a guest in the environment."""

from __future__ import annotations

import argparse
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from rce.cli import table
from rce.cli.command import parser
from rce.cli.execute import FAILURE
from rce.cli.lazy import guest as guests
from rce.cli.lazy import topics
from rce.cli.session import ConsoleSession
from rce.control.calls.robots import Definitions
from rce.control.calls.watching import RosName
from tests.support.console import Console, Request


@pytest.mark.parametrize("kind", ["topic", "service"])
def test_names_of_an_environment_are_listed(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = RosName("/scan", ["sensor_msgs/msg/LaserScan"], 1, 2)
    made = Console([found]).request(f"{kind} list brain --of eve")
    assert made == Request(f"GET environments/brain/{kind}s", {"user": "eve"})
    cells = capsys.readouterr().out.splitlines()[1].split()
    assert cells == ["/scan", "sensor_msgs/msg/LaserScan", *(["1", "2"] if kind == "topic" else [])]


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """Environments and owners for which a guest was connected."""
    connected: list[tuple[str, str]] = []

    @asynccontextmanager
    async def guest_in(session: ConsoleSession, environment: str, owner: str) -> AsyncIterator[None]:
        connected.append((environment, owner))
        yield

    monkeypatch.setattr(guests, "guest_in", guest_in)
    return connected


@pytest.mark.parametrize(
    ("line", "function", "topic"),
    [
        ("topic echo brain/scan --of eve", "echo", "/scan"),
        ("topic pub --of eve brain//say std_msgs/String", "pub", "/say"),
        ("service call --of eve brain/r2/reset", "call", "/r2/reset"),
    ],
)
def test_guest_works_on_the_topic_or_service_of_the_address(
    line: str, function: str, topic: str, served: list[tuple[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[argparse.Namespace] = []

    async def work(guest: object, args: argparse.Namespace) -> int:
        seen.append(args)
        return 5

    monkeypatch.setattr(topics, function, work)
    assert Console().run(line) == 5
    assert served == [("brain", "eve")]
    assert [each.topic for each in seen] == [topic]


def test_incomplete_address_is_refused_before_a_guest_connects(
    served: list[tuple[str, str]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert Console().run("topic hz brain") == FAILURE
    assert "write ENV/NAME" in capsys.readouterr().err
    assert not served


def test_command_in_a_shell_may_have_options_of_its_own() -> None:
    command, arguments = table.find_command(["env", "shell", "brain", "ls", "-l"])
    assert command is not None
    assert parser(command).parse_args(arguments).command == ["ls", "-l"]


def test_topic_is_described(capsys: pytest.CaptureFixture[str]) -> None:
    topics = [RosName("/pose", ["geometry_msgs/msg/Pose"], 1, 2)]
    asked = Console(topics).request("topic info brain/pose")
    assert asked.line == "GET environments/brain/topics"
    text = "Type: geometry_msgs/msg/Pose\nPublisher count: 1\nSubscription count: 2\n"
    assert capsys.readouterr().out == text
    assert Console(topics).run("topic info brain/pos") == FAILURE
    assert "did you mean /pose?" in capsys.readouterr().err


def test_definition_of_a_type_is_printed_with_those_in_it(capsys: pytest.CaptureFixture[str]) -> None:
    texts = {"geometry_msgs/msg/Twist": "Vector3 linear\n", "geometry_msgs/msg/Vector3": "float64 x\n"}
    asked = Console(Definitions(texts)).request("type show brain geometry_msgs/Twist")
    assert asked.line == "GET environments/brain/types"
    assert asked.query == {"type": "geometry_msgs/Twist", "sort": "msg"}
    assert capsys.readouterr().out.splitlines()[::2] == ["Vector3 linear", "=" * 80, "float64 x"]


def test_type_without_an_environment_is_explained(capsys: pytest.CaptureFixture[str]) -> None:
    assert Console().run("type show std_msgs/String") == FAILURE
    assert "write ENV PKG/NAME, as `rce type show brain std_msgs/String`" in capsys.readouterr().err
