"""Commands over HTTP: their effects are those of CC, DC, CN and CX, and so are their errors."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from twisted.internet.base import ReactorBase

from rce.control.calls.endpoints import NodeSpec, StartNode
from rce.control.calls.environments import StartEnvironment, StopEnvironment
from rce.control.calls.robots import DropRobot
from rce.errors import StartFailed
from tests.support.master.served import Answer, Served, serve

BRAIN = {"containerTag": "brain"}
OUT = {
    "endpointTag": "brain",
    "interfaceTag": "out",
    "interfaceType": "SubscriberInterface",
    "className": "std_msgs/String",
    "addr": "/out",
}
IN = OUT | {"endpointTag": "r1", "interfaceTag": "in", "interfaceType": "PublisherConverter", "addr": ""}


@pytest.fixture
async def served(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[Served]:
    async with serve(reactor, tmp_path) as served:
        await served.robot("ann", "r1")
        yield served


async def test_user_creates_and_removes_resources(served: Served) -> None:
    async def made(path: str, body: Any, status: int = 201) -> Answer:
        answer = await served.ask("POST", path, body=body)
        assert answer.status == status, answer.body
        if status == 201:
            place = answer.headers["location"].removeprefix("/api/v1")
            assert (await served.ask("GET", place)).body["user"] == "ann"
        return answer

    environment = await made("/environments", BRAIN | {"containerData": {"size": 2}})
    assert (environment.body["state"], environment.body["containerData"]["size"]) == ("ready", 2)
    node = await made("/environments/brain/nodes", {"nodeTag": "n", "pkg": "demo", "exe": "talker"})
    assert node.body["state"] == "running"
    assert served.peers["ann/brain"].calls[-1] == StartNode(NodeSpec("n", "demo", "talker"))
    await made("/environments/brain/parameters", {"name": "a/b", "value": [1, 2]}, 200)
    await made("/interfaces", OUT)
    await made("/interfaces", IN)
    connection = await made("/connections", {"tagA": "r1/in", "tagB": "brain/out"})
    assert (connection.body["tagA"], connection.body["state"]) == ("brain/out", "up")
    for path in (
        *("/connections/r1/in/brain/out", "/interfaces/r1/in", "/environments/brain/parameters/a%2Fb"),
        *("/environments/brain/nodes/n", "/environments/brain"),
    ):
        assert (await served.ask("DELETE", path)).status == 204
        assert (await served.ask("DELETE", path)).status == 404
    assert not list(served.master.state.interfaces)
    assert served.peers["m1"].calls[-1] == StopEnvironment("ann/brain")


async def test_operator_acts_for_a_user(served: Served) -> None:
    assert (await served.ask("POST", "/environments?user=ann", "olga", BRAIN)).body["user"] == "ann"
    assert (await served.ask("POST", "/environments?user=ann", "bob", BRAIN)).status == 404
    assert (await served.ask("POST", "/environments?user=nobody", "olga", BRAIN)).status == 404
    assert (await served.ask("POST", "/environments", "vera", BRAIN)).status == 403
    assert [each.name for each in served.master.state.environments] == ["ann/brain"]
    assert (await served.ask("DELETE", "/environments/brain?user=ann", "olga")).status == 204


@pytest.mark.parametrize(
    ("path", "body", "status", "code", "field"),
    [
        ("/environments", {"containerTag": "no-tag"}, 400, "invalid_name", "containerTag"),
        (
            "/environments",
            {"containerTag": "x", "containerData": {"size": 0}},
            400,
            "invalid_request",
            "containerData.size",
        ),
        ("/environments", {"containerTag": "x", "more": 1}, 400, "invalid_request", ""),
        ("/environments", {"containerTag": "x", "containerData": {"size": 9000}}, 400, "invalid_request", ""),
        ("/environments", {"containerTag": "r1"}, 409, "already_exists", "containerTag"),
        ("/environments/none/nodes", {"nodeTag": "n", "pkg": "p", "exe": "e"}, 404, "not_found", "containerTag"),
        ("/interfaces", OUT, 404, "not_found", "endpointTag"),
        ("/interfaces", IN | {"className": "String"}, 400, "invalid_request", "className"),
        ("/connections", {"tagA": "r1/in", "tagB": "r1/x"}, 404, "not_found", "tagA"),
        ("/connections", b"{", 400, "invalid_request", ""),
    ],
)
async def test_refused_commands(served: Served, path: str, body: Any, status: int, code: str, field: str) -> None:
    answer = await served.ask("POST", path, body=body)
    assert (answer.status, answer.body["code"]) == (status, code)
    assert answer.body.get("field", "") == field or not field
    assert answer.headers["content-type"] == "application/problem+json"


async def test_failed_start_is_rolled_back(served: Served) -> None:
    served.peers["m1"].refuse[StartEnvironment] = StartFailed("no such image")
    answer = await served.ask("POST", "/environments", body=BRAIN)
    assert (answer.status, answer.body["code"]) == (409, "start_failed")
    assert "no such image" in answer.body["detail"]
    assert not list(served.master.state.environments)


async def test_same_idempotency_key_gets_the_same_answer(served: Served) -> None:
    key = {"Idempotency-Key": "k1"}
    first, second = await asyncio.gather(*(served.ask("POST", "/environments", body=BRAIN, **key) for _ in range(2)))
    assert first.status == second.status == 201
    assert first.body == second.body
    assert (await served.ask("POST", "/environments", body=BRAIN)).status == 409
    other = await served.ask("POST", "/environments", body={"containerTag": "x"}, **key)
    assert (other.status, other.body["code"]) == (409, "key_reused")
    assert (await served.ask("POST", "/environments", "bob", BRAIN, **key)).body["user"] == "bob"


async def test_server_failure_can_be_retried_with_the_same_key(served: Served) -> None:
    served.peers["m1"].close()
    await asyncio.sleep(0)
    await served.master.join_tokens.forget("m1")
    served.master.state.forget("m1")
    key = {"Idempotency-Key": "k1"}
    assert (await served.ask("POST", "/environments", body=BRAIN, **key)).status == 503
    await served.process("container", "m2", capacity=10)
    assert (await served.ask("POST", "/environments", body=BRAIN, **key)).status == 201


async def test_robot_is_disconnected(served: Served) -> None:
    assert (await served.ask("POST", "/interfaces", body=IN)).status == 201
    assert (await served.ask("DELETE", "/robots/r1?user=ann", "bob")).status == 404
    assert (await served.ask("DELETE", "/robots/r1")).status == 204
    assert DropRobot("ann/r1", "disconnected by ann") in served.peers["west"].calls
    assert (await served.ask("GET", "/robots")).body["items"] == []
    assert (await served.ask("GET", "/interfaces")).body["items"] == []


async def test_invitation_needs_a_master_that_machines_can_join(served: Served) -> None:
    assert (await served.ask("POST", "/machines/invitations", "ann", {"name": "m2"})).status == 403
    answer = await served.ask("POST", "/machines/invitations", "olga", {"name": "m2"})
    assert (answer.status, answer.body["code"]) == (404, "not_found")
