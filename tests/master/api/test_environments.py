"""Environments, nodes and parameters over HTTP: made, shown, filtered and removed."""

from __future__ import annotations

from typing import Any

import pytest

from rce.api.roles import Scopes
from rce.control.calls.endpoints import NodeSpec, StartNode
from rce.control.calls.environments import StopEnvironment
from rce.protocol import messages as m
from tests.support.master.served import Served

BRAIN = {"containerTag": "brain"}
NODE = {"nodeTag": "n", "pkg": "demo", "exe": "talker"}


async def found(served: Served, path: str, user: str = "ann") -> list[dict[str, Any]]:
    """Return the items of a list."""
    answer = await served.ask("GET", path, user)
    assert answer.status == 200, answer.body
    items: list[dict[str, Any]] = answer.body["items"]
    return items


async def test_environment_is_created_and_removed(served: Served) -> None:
    made = await served.ask("POST", "/environments", body=BRAIN | {"containerData": {"size": 2}})
    assert made.status == 201
    assert (made.body["user"], made.body["state"], made.body["containerData"]["size"]) == ("ann", "ready", 2)
    assert made.headers["location"] == "/api/v1/environments/brain"
    assert (await served.ask("GET", "/environments/brain")).body == made.body
    assert (await served.ask("DELETE", "/environments/brain")).status == 204
    assert served.peers["m1"].calls[-1] == StopEnvironment("ann/brain")
    assert (await served.ask("DELETE", "/environments/brain")).status == 404
    assert await found(served, "/environments") == []


async def test_node_is_started_and_stopped(served: Served) -> None:
    await served.master.commands.execute("ann", m.CreateContainer("brain"))
    made = await served.ask("POST", "/environments/brain/nodes", body=NODE)
    assert (made.status, made.body["state"]) == (201, "running")
    assert made.headers["location"] == "/api/v1/environments/brain/nodes/n"
    assert served.peers["ann/brain"].calls[-1] == StartNode(NodeSpec("n", "demo", "talker"))
    assert (await served.ask("GET", "/environments/brain/nodes/n")).body == made.body
    assert await found(served, "/environments/brain/nodes") == [made.body]
    assert (await served.ask("DELETE", "/environments/brain/nodes/n")).status == 204
    assert (await served.ask("DELETE", "/environments/brain/nodes/n")).status == 404


async def test_parameter_is_set_and_deleted(served: Served) -> None:
    await served.master.commands.execute("ann", m.CreateContainer("brain"))
    path = "/environments/brain/parameters"
    for value in ([1, 2], [3]):
        answer = await served.ask("POST", path, body={"name": "a/b", "value": value})
        assert (answer.status, answer.body["value"]) == (200, value)
    assert (await served.ask("GET", f"{path}/a%2Fb")).body == answer.body
    assert (await served.ask("DELETE", f"{path}/a%2Fb")).status == 204
    assert (await served.ask("DELETE", f"{path}/a%2Fb")).status == 404


async def test_parameter_of_a_node_is_apart_from_one_of_the_environment(populated: Served) -> None:
    path = "/environments/brain/parameters"
    await populated.ask("POST", path, body={"name": "rate", "value": 1})
    assert (await populated.ask("GET", f"{path}/rate")).body["value"] == 1
    of_node = (await populated.ask("GET", f"{path}/rate?node=talker")).body
    assert (of_node["value"], of_node["nodeTag"]) == (10, "talker")
    assert [each["name"] for each in await found(populated, f"{path}?node=talker")] == ["rate"]
    assert [each["name"] for each in await found(populated, f"{path}?node=")] == ["arm/gain", "rate"]
    assert len(await found(populated, path)) == 3
    assert (await populated.ask("DELETE", f"{path}/rate?node=talker")).status == 204
    assert (await populated.ask("GET", f"{path}/rate")).body["value"] == 1


async def test_environment_shows_where_it_runs_and_what_is_in_it(populated: Served) -> None:
    environment = (await populated.ask("GET", "/environments/brain")).body
    assert environment["state"] == "ready"
    assert (environment["machine"], environment["nodes"], environment["parameters"]) == ("m1", 1, 2)
    assert environment["containerData"]["group"] == "team"
    node = (await populated.ask("GET", "/environments/brain/nodes/talker")).body
    assert (node["pkg"], node["exe"], node["state"]) == ("demo", "talker", "running")


async def test_list_is_filtered(populated: Served) -> None:
    for query, tags in (
        ("", ["brain"]),
        ("?machine=m1", ["brain"]),
        ("?machine=m2", []),
        ("?machine=", []),
        ("?state=ready", ["brain"]),
        ("?state=starting", []),
        ("?group=team", ["brain"]),
        ("?group=other", []),
        ("?state=ready&group=team", ["brain"]),
    ):
        listed = await found(populated, "/environments" + query)
        assert [each["containerTag"] for each in listed] == tags, query


async def test_restricted_key_lists_its_environments(served: Served) -> None:
    for tag in ("brain", "attic"):
        await served.master.commands.execute("ann", m.CreateContainer(tag))
    secret, _ = await served.master.users.keys.add("ann", scopes=Scopes(environments=["brain"]))
    listed = await served.ask("GET", "/environments", secret=secret)
    assert [each["containerTag"] for each in listed.body["items"]] == ["brain"]
    for path in ("/environments/attic", "/environments/attic/nodes", "/environments/attic/parameters"):
        assert (await served.ask("GET", path, secret=secret)).status == 404


async def test_what_does_not_exist_is_not_found(populated: Served) -> None:
    for path, field in (
        ("/environments/none", "environment"),
        ("/environments/none/nodes", "environment"),
        ("/environments/none/nodes/n", "environment"),
        ("/environments/none/parameters", "environment"),
        ("/environments/none/parameters/rate", "environment"),
        ("/environments/brain/nodes/none", "node"),
        ("/environments/brain/parameters/none", "name"),
        ("/environments/brain/parameters/arm%2Fgain?node=talker", "name"),
    ):
        answer = await populated.ask("GET", path)
        assert (answer.status, answer.body["field"]) == (404, field)


async def test_what_is_removed_before_the_answer_is_not_found(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    execute = served.master.commands.execute

    async def execute_and_remove(user: str, command: m.Command, robot: str) -> None:
        await execute(user, command)
        await execute(user, m.DestroyContainer("brain"))

    monkeypatch.setattr(served.master.commands, "execute", execute_and_remove)
    answer = await served.ask("POST", "/environments", body=BRAIN)
    assert (answer.status, answer.body["field"]) == (404, "environment")
    await execute("ann", m.CreateContainer("brain"))
    answer = await served.ask("POST", "/environments/brain/nodes", body=NODE)
    assert (answer.status, answer.body["field"]) == (404, "node")
