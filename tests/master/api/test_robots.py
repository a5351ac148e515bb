"""Robots over HTTP: those that have a session are shown, and can be disconnected."""

from __future__ import annotations

from rce.api.roles import Scopes
from rce.control.calls.robots import DropRobot
from tests.support.master.served import Served


async def test_robot_shows_its_session(populated: Served) -> None:
    robot = (await populated.ask("GET", "/robots/r1")).body
    assert robot == {
        "user": "ann",
        "robotID": "r1",
        "state": "connected",
        "endpoint": "west",
        "interfaces": 1,
        "guest": "",
    }
    assert (await populated.ask("GET", "/robots")).body == {"items": [robot], "next": ""}


async def test_list_is_filtered(populated: Served) -> None:
    for query, tags in (("?endpoint=west", ["r1"]), ("?endpoint=east", []), ("?user=*", ["r1"])):
        listed = (await populated.ask("GET", "/robots" + query)).body["items"]
        assert [each["robotID"] for each in listed] == tags, query


async def test_restricted_key_sees_its_own_robot(served: Served) -> None:
    for tag in ("r1", "r2"):
        await served.robot("ann", tag)
    secret, _ = await served.master.users.keys.add("ann", scopes=Scopes(robot="r1"))
    listed = await served.ask("GET", "/robots", secret=secret)
    assert [each["robotID"] for each in listed.body["items"]] == ["r1"]
    assert (await served.ask("GET", "/robots/r2", secret=secret)).status == 404


async def test_robot_is_disconnected(populated: Served) -> None:
    assert (await populated.ask("DELETE", "/robots/r1?user=ann", "bob")).status == 404
    assert (await populated.ask("DELETE", "/robots/r1")).status == 204
    assert DropRobot("ann/r1", "disconnected by ann") in populated.peers["west"].calls
    assert (await populated.ask("GET", "/robots")).body["items"] == []
    left = (await populated.ask("GET", "/interfaces")).body["items"]
    assert [each["endpointTag"] for each in left] == ["brain"]
    answer = await populated.ask("DELETE", "/robots/r1")
    assert (answer.status, answer.body["field"]) == (404, "robotID")
