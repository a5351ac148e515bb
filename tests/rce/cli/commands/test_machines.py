"""`machine`, `group`, `events`."""

from __future__ import annotations

import time

import pytest

from rce.api.views import Event, GroupView, Invited, Usage
from tests.support.console import Console, Request, environment, machine

NOON = time.mktime((2030, 1, 31, 12, 0, 0, 0, 0, -1))


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("machine list", Request("GET machines", {})),
        ("machine stats", Request("GET machines", {"role": "container"})),
        ("machine environments m1", Request("GET environments", {"user": "*", "machine": "m1"})),
        ("group list --of all", Request("GET groups", {"user": "*"})),
    ],
)
def test_list_is_requested(line: str, expected: Request) -> None:
    assert Console([]).request(line) == expected


def test_machine_without_slots_is_listed_without_use(capsys: pytest.CaptureFixture[str]) -> None:
    Console([machine(), machine("west", role="robot", slots=0, used=0)]).request("machine list")
    _, first, second = capsys.readouterr().out.splitlines()
    assert first.split()[:4] == ["machine-1", "container", "joined", "3/10"]
    assert second.split()[:4] == ["west", "robot", "joined", "-"]


@pytest.mark.parametrize(("addresses", "host"), [(["10.0.0.7"], "10.0.0.7"), ([], "*")])
def test_url_without_a_host_is_completed(addresses: list[str], host: str, capsys: pytest.CaptureFixture[str]) -> None:
    Console([machine("west", role="robot", url="ws://:9010/", addresses=addresses)]).request("machine list")
    assert capsys.readouterr().out.split()[-1] == f"ws://{host}:9010/"


def test_statistics_of_one_machine(capsys: pytest.CaptureFixture[str]) -> None:
    made = Console(machine(usage=Usage(1.25, 2**30), gpus=2, gpusUsed=1)).request("machine stats machine-1")
    assert made == Request("GET machines/machine-1", {})
    cells = capsys.readouterr().out.splitlines()[1].split()
    assert cells == ["machine-1", "joined", "3", "10", "1", "2", "3", "1.25", "1", "GiB"]


def test_machine_is_named_by_its_address_as_in_the_original() -> None:
    console = Console([machine("m1"), machine("m2", addresses=["10.0.0.7"])], machine("m2"))
    assert console.run("machine --stats 10.0.0.7") == 0
    assert [each.line for each in console.api.requests] == ["GET machines", "GET machines/m2"]
    console = Console([machine("m2", addresses=["10.0.0.7"])], [environment()])
    assert console.run("machine -c 10.0.0.7") == 0
    assert console.api.requests[1] == Request("GET environments", {"user": "*", "machine": "m2"})


def test_unknown_address_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert Console([machine("m1")]).run("machine -s 10.0.0.8") == 1
    assert "no task set has the address 10.0.0.8" in capsys.readouterr().err


def test_statistics_of_an_unwatched_machine_have_no_usage(capsys: pytest.CaptureFixture[str]) -> None:
    Console([machine()]).request("machine stats")
    assert capsys.readouterr().out.splitlines()[1].split()[-2:] == ["-", "-"]


def test_machine_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert Console(machine(features=["gpu"])).request("machine show m1") == Request("GET machines/m1", {})
    assert ["features", "gpu"] in [line.split() for line in capsys.readouterr().out.splitlines()]


def test_environments_of_a_machine_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    Console([environment(user="eve")]).request("machine environments machine-1")
    assert capsys.readouterr().out.splitlines()[1].split()[:2] == ["brain", "eve"]


@pytest.mark.parametrize(
    ("options", "changes"),
    [
        ("", {}),
        ("--role container", {"roles": ["container"]}),
        ("--address 10.0.0.2 --hours 0.5", {"address": "10.0.0.2", "hours": 0.5}),
    ],
)
def test_invitation_prints_the_join_code_alone(
    options: str, changes: dict[str, object], capsys: pytest.CaptureFixture[str]
) -> None:
    made = Console(Invited("hall-2", "code", NOON)).request(f"machine add hall-2 {options}")
    body = {"name": "hall-2", "roles": made.body["roles"], "address": "", "hours": 24.0}
    assert made == Request("POST machines/invitations", {}, body | changes)
    assert {"robot", "container"} <= set(made.body["roles"]) or "roles" in changes
    assert capsys.readouterr().out == "code\n"


def test_machine_is_removed(capsys: pytest.CaptureFixture[str]) -> None:
    assert Console(None).request("machine remove hall-2") == Request("DELETE machines/hall-2", {})
    assert capsys.readouterr().out == ""


def test_group_is_shown_with_the_addresses_of_its_members(capsys: pytest.CaptureFixture[str]) -> None:
    found = GroupView("ann", "fleet", "10.128.0.0/24", {"a": "10.128.0.2", "b": "10.128.0.3"})
    assert Console(found).request("group show fleet") == Request("GET groups/fleet", {})
    assert "members  a=10.128.0.2, b=10.128.0.3" in capsys.readouterr().out.splitlines()


def test_event_is_printed_with_the_last_lines_of_the_output(capsys: pytest.CaptureFixture[str]) -> None:
    died = Event("7", NOON, "node.died", "ann", "ann/brain/echo", "exit status 1", 1, ["Traceback", "KeyError"])
    came = Event("8", NOON, "robot.came", "ann", "ann/r2")
    assert Console([died, came]).request("events --of all") == Request("FOLLOW events", {"user": "*"})
    assert capsys.readouterr().out.splitlines() == [
        "12:00:00  node.died           ann/brain/echo  exit status 1",
        "    Traceback",
        "    KeyError",
        "12:00:00  robot.came          ann/r2",
    ]


def test_events_in_json_are_lines_as_the_platform_sends_them(capsys: pytest.CaptureFixture[str]) -> None:
    Console([Event("8", 1.0, "robot.came", "ann", "ann/r2")]).request("events --json")
    expected = '{"id":"8","time":1.0,"type":"robot.came","user":"ann","object":"ann/r2"}\n'
    assert capsys.readouterr().out == expected
