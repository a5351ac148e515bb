"""`robot`, `interface`, `connection`, `connect`, `disconnect`."""

from __future__ import annotations

import pytest

from rce.api.views import ConnectionView, Rate, RobotView
from rce.cli.execute import FAILURE, SUCCESS
from tests.support.console import Console, Request, interface


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("robot list", Request("GET robots", {})),
        ("robot list --of all", Request("GET robots", {"user": "*"})),
        ("interface list", Request("GET interfaces", {})),
        (
            "interface list brain --type std_msgs/String --of eve",
            Request("GET interfaces", {"owner": "brain", "type": "std_msgs/String", "user": "eve"}),
        ),
        ("connection list --of all", Request("GET connections", {"user": "*"})),
    ],
)
def test_list_is_requested(line: str, expected: Request) -> None:
    assert Console([]).request(line) == expected


def test_robot_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    found = RobotView("ann", "r2", "away", "west", 2)
    assert Console(found).request("robot show r2 --of ann") == Request("GET robots/r2", {"user": "ann"})
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines == [["user", "ann"], ["robotID", "r2"], ["state", "away"], ["endpoint", "west"], ["interfaces", "2"]]


def test_each_named_robot_is_disconnected() -> None:
    console = Console()
    assert console.run("robot disconnect r2 r3") == SUCCESS
    assert console.api.requests == [Request("DELETE robots/r2", {}), Request("DELETE robots/r3", {})]


def test_interfaces_are_listed_with_their_rates_while_these_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    Console([interface(rate=Rate(9.5, 1e3, 2, 7)), interface("r2")]).request("interface list")
    _, first, second = capsys.readouterr().out.splitlines()
    assert first.split()[0] == "brain/pose"
    assert first.split()[-4:] == ["1", "9.5", "2", "7"]
    assert second.split()[-4:] == ["1", "-", "-", "-"]


def test_interface_is_added_with_its_quality_of_service() -> None:
    line = "interface add brain/pose PublisherInterface geometry_msgs/Pose2D /pose --reliability reliable --depth 1"
    made = Console().request(line)
    assert (made.line, made.body["qos"]) == ("POST interfaces", {"reliability": "reliable", "depth": 1})
    assert {name: value for name, value in made.body.items() if name != "qos"} == {
        "endpointTag": "brain",
        "interfaceTag": "pose",
        "interfaceType": "PublisherInterface",
        "className": "geometry_msgs/Pose2D",
        "addr": "/pose",
        "format": "png",
        "delivery": {},
        "codec": "",
    }


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("interface show brain/pose", "GET interfaces/brain/pose"),
        ("interface remove brain/pose", "DELETE interfaces/brain/pose"),
        ("disconnect r2/pose brain/pose", "DELETE connections/r2/pose/brain/pose"),
    ],
)
def test_parts_of_an_interfaces_name_are_parts_of_the_path(line: str, expected: str) -> None:
    assert Console(interface()).request(line).line == expected


@pytest.mark.parametrize(
    "line", ["interface show brain", "interface remove brain", "disconnect r2 brain/pose", "disconnect r2/pose brain"]
)
def test_name_without_an_endpoint_is_refused(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    console = Console()
    assert console.run(line) == FAILURE
    assert "endpointTag/interfaceTag" in capsys.readouterr().err
    assert not console.api.requests


def test_two_interfaces_are_connected() -> None:
    made = Console().request("connect r2/pose brain/pose --of eve")
    assert made == Request("POST connections", {"user": "eve"}, {"tagA": "r2/pose", "tagB": "brain/pose"})


def test_connections_are_listed_in_the_direction_of_messages(capsys: pytest.CaptureFixture[str]) -> None:
    Console([ConnectionView("ann", "r2/pose", "brain/pose", "up", "geometry_msgs/Pose2D")]).request("connection list")
    cells = capsys.readouterr().out.splitlines()[1].split()
    assert cells == ["r2/pose", "brain/pose", "ann", "up", "geometry_msgs/Pose2D", "-", "-"]
