"""Commands over HTTP: who may give them for whom, and their errors, which are those of robots' commands."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from master.api.commands import Commands, created
from rce.api.roles import Principal
from rce.control.calls.environments import StartEnvironment
from rce.errors import StartFailed
from rce.protocol import messages as m
from tests.support.master.bodies import IN, OUT
from tests.support.master.calls import make_call
from tests.support.master.served import Served

BRAIN = {"containerTag": "brain"}
ANN, OLGA = Principal("ann", "user"), Principal("olga", "operator")


@pytest.fixture
async def served(served: Served) -> Served:
    await served.robot("ann", "r1")
    return served


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


async def test_command_goes_on_when_its_client_disconnects(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, may_end, ended = asyncio.Event(), asyncio.Event(), asyncio.Event()

    async def execute(user: str, command: m.Command, robot: str) -> None:
        begun.set()
        await may_end.wait()
        ended.set()

    monkeypatch.setattr(served.master.commands, "execute", execute)
    asked = asyncio.ensure_future(Commands(served.master).execute(make_call(ANN), "", m.CreateContainer("brain")))
    await asyncio.wait_for(begun.wait(), 20)
    asked.cancel()
    await asyncio.wait([asked])
    assert not ended.is_set()
    may_end.set()
    await asyncio.wait_for(ended.wait(), 20)


@pytest.mark.parametrize(
    ("caller", "location"),
    [(ANN, "/api/v1/environments/a%2Fb/%C3%BC"), (OLGA, "/api/v1/environments/a%2Fb/%C3%BC?user=ann")],
)
def test_location_of_a_new_resource_is_for_the_caller(caller: Principal, location: str) -> None:
    answer = created(make_call(caller), "ann", m.CreateContainer("x"), "environments", "a/b", "ü")
    assert (answer.status, answer.headers) == (201, {"location": location})
