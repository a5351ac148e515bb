"""Interfaces and connections over HTTP: made, shown, filtered and removed."""

from __future__ import annotations

from rce.api.roles import Scopes
from rce.protocol import messages as m
from tests.support.master.bodies import IN, OUT
from tests.support.master.served import Served


async def test_interfaces_are_added_connected_and_removed(served: Served) -> None:
    await served.robot("ann", "r1")
    await served.master.commands.execute("ann", m.CreateContainer("brain"))
    for body in (OUT, IN):
        made = await served.ask("POST", "/interfaces", body=body)
        assert (made.status, made.body["user"], made.body["className"]) == (201, "ann", "std_msgs/String")
        assert made.headers["location"] == f"/api/v1/interfaces/{body['endpointTag']}/{body['interfaceTag']}"
    made = await served.ask("POST", "/connections", body={"tagA": "r1/in", "tagB": "brain/out"})
    assert (made.status, made.body["tagA"], made.body["tagB"], made.body["state"]) == (201, "brain/out", "r1/in", "up")
    assert made.headers["location"] == "/api/v1/connections/brain/out/r1/in"
    for path in ("/connections/r1/in/brain/out", "/interfaces/r1/in"):
        assert (await served.ask("DELETE", path)).status == 204
        assert (await served.ask("DELETE", path)).status == 404
    assert [each.key for each in served.master.state.interfaces] == ["ann/brain/out"]


async def test_interface_shows_its_state_and_connections(populated: Served) -> None:
    interface = (await populated.ask("GET", "/interfaces/brain/out")).body
    assert (interface["state"], interface["addr"], interface["connections"]) == ("ready", "/out", 1)


async def test_connection_is_found_from_both_sides(populated: Served) -> None:
    (connection,) = (await populated.ask("GET", "/connections")).body["items"]
    assert (connection["tagA"], connection["tagB"], connection["state"]) == ("brain/out", "r1/in", "up")
    for path in ("/connections/brain/out/r1/in", "/connections/r1/in/brain/out"):
        assert (await populated.ask("GET", path)).body == connection


async def test_lists_are_filtered(populated: Served) -> None:
    for path, count in (
        ("/interfaces", 2),
        ("/interfaces?owner=brain", 1),
        ("/interfaces?owner=attic", 0),
        ("/interfaces?type=std_msgs/String", 2),
        ("/interfaces?type=std_msgs/msg/String", 2),
        ("/interfaces?type=std_msgs/msg/Bool", 0),
        ("/interfaces?kind=PublisherConverter", 1),
        ("/interfaces?kind=PublisherConverter&owner=brain", 0),
        ("/connections", 1),
        ("/connections?owner=brain", 1),
        ("/connections?owner=r1", 1),
        ("/connections?owner=attic", 0),
        ("/connections?interface=r1/in", 1),
        ("/connections?interface=r1/other", 0),
    ):
        assert len((await populated.ask("GET", path)).body["items"]) == count, path


async def test_filter_by_something_that_is_no_type_names_the_parameter(served: Served) -> None:
    answer = await served.ask("GET", "/interfaces?type=String")
    assert (answer.status, answer.body["code"], answer.body["field"]) == (400, "invalid_request", "type")


async def test_what_does_not_exist_is_not_found(populated: Served) -> None:
    for path, field in (
        ("/interfaces/brain/none", "interface"),
        ("/interfaces/none/out", "interface"),
        ("/connections/brain/out/r1/none", "ownerA"),
        ("/connections/brain/out/brain/out", "ownerA"),
    ):
        answer = await populated.ask("GET", path)
        assert (answer.status, answer.body["field"]) == (404, field)


async def test_restricted_key_does_not_see_the_side_of_others(populated: Served) -> None:
    secret, _ = await populated.master.users.keys.add("ann", scopes=Scopes(robot="r2", environments=["brain"]))
    listed = (await populated.ask("GET", "/interfaces", secret=secret)).body["items"]
    assert [each["endpointTag"] for each in listed] == ["brain"]
    assert (await populated.ask("GET", "/connections", secret=secret)).body["items"] == []
    for path in ("/interfaces/r1/in", "/connections/brain/out/r1/in"):
        assert (await populated.ask("GET", path, secret=secret)).status == 404
