"""API keys over HTTP: made, listed without their secrets, rotated and revoked."""

from __future__ import annotations

import time
from typing import Any

import pytest

from rce.control.calls.robots import DropRobot, Login
from tests.support.master.api_keys import ask_by_key, make_key
from tests.support.master.served import Served


async def test_sign_in_creates_a_key_and_sign_out_revokes_it(served: Served) -> None:
    for user, role in (("ann", "user"), ("vera", "viewer"), ("root", "admin")):
        name, secret = await make_key(served, user, label="console", expires=time.time() + 1000)
        who = (await ask_by_key(served, secret, "GET", "/whoami")).body
        assert (who["user"], who["role"], who["key"]) == (user, role, name)
        assert who["rights"]["environment.create"] == {"user": "own", "viewer": "-", "admin": "all"}[role]
        assert (await ask_by_key(served, secret, "DELETE", f"/keys/{name}")).status == 204
        assert (await ask_by_key(served, secret, "GET", "/whoami")).status == 401


async def test_keys_are_listed_without_secrets_to_their_users(served: Served) -> None:
    name, secret = await make_key(served, label="r1", scopes={"robot": "r1"}, role="robot")
    (shown,) = (await served.ask("GET", "/keys")).body["items"]
    assert (shown["id"], shown["label"], shown["role"], shown["scopes"]) == (name, "r1", "robot", {"robot": "r1"})
    assert shown == (await served.ask("GET", f"/keys/{name}")).body
    assert secret not in str(shown)
    for user in ("bob", "olga", "vera"):
        assert (await served.ask("GET", "/keys?user=*", user)).body["items"] == []
        for method, path in (("GET", ""), ("DELETE", ""), ("POST", "/rotate")):
            for query in ("", "?user=ann", "?user=nobody"):
                assert (await served.ask(method, f"/keys/{name}{path}{query}", user)).status == 404
    assert (await served.ask("GET", "/keys?user=*", "root")).body["items"] == [shown]
    assert (await served.ask("DELETE", f"/keys/{name}?user=ann", "root")).status == 204


async def test_key_of_a_robot_creates_no_keys_but_can_sign_out(served: Served) -> None:
    name, secret = await make_key(served, role="robot")
    other, _ = await make_key(served, role="robot")
    assert (await ask_by_key(served, secret, "POST", "/keys", {})).status == 403
    assert (await ask_by_key(served, secret, "DELETE", f"/keys/{other}")).status == 403
    assert (await ask_by_key(served, secret, "DELETE", f"/keys/{name}")).status == 204


async def test_key_has_no_more_rights_than_its_creator(served: Served) -> None:
    _, viewer = await make_key(served, role="viewer")
    assert (await ask_by_key(served, viewer, "POST", "/keys", {"role": "user"})).status == 403
    assert (await ask_by_key(served, viewer, "POST", "/keys", {})).body["key"]["role"] == "viewer"
    assert (await served.ask("POST", "/keys", "ann", {"role": "operator"})).status == 403
    assert (await served.ask("POST", "/keys?user=ann", "root", {"role": "operator"})).status == 403
    assert (await served.ask("POST", "/keys?user=ann", "root", {})).body["key"]["role"] == "user"


@pytest.mark.parametrize(
    ("wanted", "field"),
    [
        ({"expires": 1.0}, "expires"),
        ({"role": "user", "scopes": {"robot": "r"}}, "scopes"),
        ({"role": "robot", "scopes": {"environments": ["a/b"]}}, "scopes.environments"),
        ({"scopes": {"metrics": True}}, "scopes.metrics"),
        ({"role": "king"}, "role"),
        ({"colour": "red"}, "colour"),
    ],
)
async def test_wrong_keys_are_refused(served: Served, wanted: Any, field: str) -> None:
    answer = await served.ask("POST", "/keys", "ann", wanted)
    assert (answer.status, answer.body.get("field", "")) == (400, field), answer.body


async def test_rotated_key_disconnects_the_robot_with_the_old_secret(served: Served) -> None:
    name, secret = await make_key(served, role="robot")
    await served.call_master("west", Login("ann", "r1", secret))
    fresh = (await served.ask("POST", f"/keys/{name}/rotate")).body
    assert fresh["key"]["id"] == name
    await served.wait_for_call("west", DropRobot("ann/r1", "the API key has a new secret"))
    assert (await ask_by_key(served, secret, "GET", "/whoami")).status == 401
    assert (await ask_by_key(served, fresh["secret"], "GET", "/whoami")).status == 200


async def test_temporary_key_of_a_service_does_not_revoke_the_key_that_lent_it(served: Served) -> None:
    name, _ = await make_key(served, role="user")
    grants = served.master.users.grants
    lent = await grants.issue_key("maps", await grants.give("maps", "ann", name), 60)
    assert (await ask_by_key(served, lent.key, "GET", "/whoami")).body["key"] == name
    assert (await ask_by_key(served, lent.key, "DELETE", f"/keys/{name}")).status == 403
    assert (await served.ask("GET", f"/keys/{name}")).status == 200


@pytest.mark.parametrize(
    ("caller", "target", "scopes"),
    [("viewer", "admin", {}), ("viewer", "robot", {}), ("user", "operator", {}), ("user", "admin", {"metrics": True})],
)
async def test_key_touches_no_key_that_may_do_more(served: Served, caller: str, target: str, scopes: Any) -> None:
    name, secret = await make_key(served, "root", role=target, scopes=scopes)
    _, weak = await make_key(served, "root", role=caller)
    for method, path in (("POST", f"/keys/{name}/rotate"), ("DELETE", f"/keys/{name}")):
        assert (await ask_by_key(served, weak, method, path)).status == 403
    assert (await ask_by_key(served, secret, "GET", "/whoami")).status == 200


async def test_expiring_key_cannot_make_a_lasting_one(served: Served) -> None:
    soon = time.time() + 100
    _, secret = await make_key(served, role="user", expires=soon)
    lasting, _ = await make_key(served, role="user")
    later = await ask_by_key(served, secret, "POST", "/keys", {"expires": soon + 1})
    assert (later.status, later.body["field"]) == (403, "expires")
    assert (await ask_by_key(served, secret, "POST", "/keys", {})).body["key"]["expires"] == soon
    assert (await ask_by_key(served, secret, "POST", f"/keys/{lasting}/rotate")).status == 403
    assert (await served.ask("POST", f"/keys/{lasting}/rotate")).status == 200


async def test_signing_out_ends_the_keys_that_were_made_with_the_key(served: Served) -> None:
    name, secret = await make_key(served, "root")
    child = (await ask_by_key(served, secret, "POST", "/keys?user=ann", {"role": "robot"})).body
    assert child["key"]["parent"] == name
    await served.call_master("west", Login("ann", "r1", child["secret"]))
    assert (await ask_by_key(served, secret, "DELETE", f"/keys/{name}")).status == 204
    await served.wait_for_call("west", DropRobot("ann/r1", "the API key was revoked"))
    assert (await ask_by_key(served, child["secret"], "GET", "/whoami")).status == 401
