"""Users, passwords, keys, limits and the audit log over HTTP."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from twisted.internet.base import ReactorBase

from master.access.throttle import Throttle
from master.access.users import digest
from master.graph.limits import Policy
from rce.control.calls.call import Call
from rce.control.calls.environments import StopEnvironment
from rce.control.calls.robots import DropRobot, Execute, Login
from rce.errors import LimitExceeded
from rce.protocol import messages as m
from tests.support.master.served import PASSWORD, Answer, Served, serve

GOOD = "correct horse battery"


@pytest.fixture
async def served(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[Served]:
    async with serve(reactor, tmp_path, Policy(environments=3)) as served:
        yield served


async def key(served: Served, user: str = "ann", **wanted: Any) -> tuple[str, str]:
    """The id and the secret of a key that a user makes."""
    made = await served.ask("POST", "/keys", user, wanted)
    assert made.status == 201, made.body
    return made.body["key"]["id"], made.body["secret"]


async def by_key(served: Served, secret: str, method: str, path: str, body: Any = None) -> Answer:
    return await served.ask(method, path, "", body, Authorization=f"Bearer {secret}")


# --- who one is, and keys ---------------------------------------------------------------------------------------------


async def test_sign_in_creates_a_key_and_sign_out_revokes_it(served: Served) -> None:
    for user, role in (("ann", "user"), ("vera", "viewer"), ("root", "admin")):
        name, secret = await key(served, user, label="console", expires=time.time() + 1000)
        who = (await by_key(served, secret, "GET", "/whoami")).body
        assert (who["user"], who["role"], who["key"]) == (user, role, name)
        assert who["rights"]["environment.create"] == {"user": "own", "viewer": "-", "admin": "all"}[role]
        assert (await by_key(served, secret, "DELETE", f"/keys/{name}")).status == 204
        assert (await by_key(served, secret, "GET", "/whoami")).status == 401


async def test_keys_are_listed_without_secrets_to_their_users(served: Served) -> None:
    name, secret = await key(served, label="r1", scopes={"robot": "r1"}, role="robot")
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
    name, secret = await key(served, role="robot")
    other, _ = await key(served, role="robot")
    assert (await by_key(served, secret, "POST", "/keys", {})).status == 403
    assert (await by_key(served, secret, "DELETE", f"/keys/{other}")).status == 403
    assert (await by_key(served, secret, "DELETE", f"/keys/{name}")).status == 204


async def test_key_has_no_more_rights_than_its_creator(served: Served) -> None:
    _, viewer = await key(served, role="viewer")
    assert (await by_key(served, viewer, "POST", "/keys", {"role": "user"})).status == 403
    assert (await by_key(served, viewer, "POST", "/keys", {})).body["key"]["role"] == "viewer"
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
        ({"colour": "red"}, ""),
    ],
)
async def test_wrong_keys_are_refused(served: Served, wanted: Any, field: str) -> None:
    answer = await served.ask("POST", "/keys", "ann", wanted)
    assert (answer.status, answer.body.get("field", "")) == (400, field), answer.body


async def test_rotated_key_disconnects_the_robot_with_the_old_secret(served: Served) -> None:
    name, secret = await key(served, role="robot")
    await served.call_master("west", Login("ann", "r1", secret))
    fresh = (await served.ask("POST", f"/keys/{name}/rotate")).body
    assert fresh["key"]["id"] == name
    await served.wait_for_call("west", DropRobot("ann/r1", "the API key has a new secret"))
    assert (await by_key(served, secret, "GET", "/whoami")).status == 401
    assert (await by_key(served, fresh["secret"], "GET", "/whoami")).status == 200


# --- users ------------------------------------------------------------------------------------------------------------


async def test_administrator_creates_changes_and_removes_users(served: Served) -> None:
    made = await served.ask("POST", "/users", "root", {"name": "carl", "password": GOOD})
    assert (made.status, made.body["role"]) == (201, "user")
    assert (await served.ask("GET", "/users/carl", "carl", secret=GOOD)).body == made.body
    assert (await served.ask("POST", "/users", "root", {"name": "carl", "password": GOOD})).status == 409
    name, secret = await key(served, "root", role="robot")
    await served.ask("PATCH", "/users/carl", "root", {"role": "operator"})
    assert [each["name"] for each in (await served.ask("GET", "/users", "carl", secret=GOOD)).body["items"]] == [
        *("ann", "bob", "carl", "olga", "root", "vera"),
    ]
    await served.robot("ann", "r1")
    await served.master.commands.execute("ann", m.CreateContainer("brain"))
    assert (await served.ask("DELETE", "/users/ann", "root")).status == 204
    await served.wait_for_call("m1", StopEnvironment("ann/brain"))
    assert (await served.ask("GET", "/robots")).status == 401
    assert (await served.ask("GET", "/robots?user=*", "root")).body["items"] == []
    assert (await served.ask("DELETE", "/users/root", "root")).status == 400  # the last administrator
    assert (await by_key(served, secret, "GET", "/robots")).status == 200
    assert name


async def test_users_see_only_themselves(served: Served) -> None:
    for user in ("ann", "vera"):
        assert [each["name"] for each in (await served.ask("GET", "/users", user)).body["items"]] == [user]
        for other in ("bob", "nobody"):
            answer = await served.ask("GET", f"/users/{other}", user)
            assert (answer.status, answer.body["detail"]) == (404, f"there is no user {other}")
        for method, path, body in (
            ("POST", "/users", {"name": "x", "password": GOOD}),
            ("PATCH", "/users/{}", {"role": "admin"}),
            ("DELETE", "/users/{}", None),
            ("PATCH", "/users/{}/limits", {"environments": 100}),
        ):
            for other in ("ann", "bob", "nobody"):
                assert (await served.ask(method, path.format(other), user, body)).status == 403


async def test_own_password_is_changed_with_the_old_one(served: Served) -> None:
    served.master.users.throttle = Throttle(lambda: 0.0)
    name, secret = await key(served)
    await served.robot("ann", "r1")
    for body, status, field in (
        ({"new": GOOD}, 403, "old"),
        ({"new": GOOD, "old": "wrong"}, 403, "old"),
        ({"new": "ann", "old": PASSWORD}, 400, "password"),
        ({"new": "password1234", "old": PASSWORD}, 400, "password"),
    ):
        answer = await served.ask("PUT", "/users/ann/password", "ann", body)
        assert (answer.status, answer.body["field"]) == (status, field)
    assert (await served.ask("PUT", "/users/ann/password", "ann", {"new": GOOD, "old": PASSWORD})).status == 204
    await served.wait_for_call("west", DropRobot("ann/r1", "the password was changed"))
    assert (await served.ask("GET", "/whoami")).status == 401
    assert (await served.ask("GET", "/whoami", secret=GOOD)).status == 200
    assert (await by_key(served, secret, "GET", f"/keys/{name}")).status == 200
    assert (await served.ask("PUT", "/users/ann/password", "root", {"new": GOOD + "!"})).status == 204
    assert (await served.ask("PUT", "/users/root/password", "root", {"new": GOOD})).status == 403
    for other in ("bob", "nobody"):
        assert (await served.ask("PUT", f"/users/{other}/password", "olga", {"new": GOOD})).status == 404


async def test_password_guessing_is_throttled(served: Served) -> None:
    served.master.users.throttle = Throttle(lambda: 0.0)
    for user in ("ann", "nobody"):
        answers = [await served.ask("GET", "/whoami", user, secret="wrong") for _ in range(6)]
        assert [answer.status for answer in answers] == [401] * 5 + [429]
        assert answers[-1].headers["retry-after"] == "1"
        assert answers[-1].body["fields"]["retry_after"] == 1
    assert (await served.ask("GET", "/whoami")).status == 429


# --- limits -----------------------------------------------------------------------------------------------------------


async def test_limits_take_effect_at_once_and_are_shown_with_usage(served: Served) -> None:
    assert (await served.ask("GET", "/users/ann/limits")).body["environments"] == 3
    change = {"environments": 1, "memory": "1GiB", "total_bandwidth": "10M", "images": "mine/*,rce/base", "cpu": 1.5}
    changed = (await served.ask("PATCH", "/users/ann/limits", "root", change)).body
    assert changed == (await served.ask("GET", "/users/ann/limits")).body
    assert (changed["memory"], changed["total_bandwidth"], changed["images"]) == (
        2**30,
        10_000_000,
        ["mine/*", "rce/base"],
    )
    await served.robot("ann", "r1")
    await served.master.commands.execute("ann", m.CreateContainer("brain"))
    used = (await served.ask("GET", "/users/ann/usage")).body
    assert (used["environments"], used["robots"], used["connections"], used["total_bandwidth"]) == (1, 1, 0, 10**7)
    refused = await served.ask("POST", "/environments", "ann", {"containerTag": "more"})
    assert (refused.status, refused.body["fields"]["limit"]) == (413, 1)
    await served.ask("PATCH", "/users/ann/limits", "root", {"environments": None, "total_bandwidth": "", "memory": 0})
    assert (await served.ask("POST", "/environments", "ann", {"containerTag": "more"})).status == 201
    assert (await served.ask("GET", "/users/bob/usage", "ann")).status == 404
    assert (await served.ask("GET", "/users/nobody/usage", "root")).status == 404


@pytest.mark.parametrize("change", [{"memory": "lots"}, {"memory": -1}, {"wings": 2}, {"robots": [1]}, {"egress": "x"}])
async def test_wrong_limits_are_refused(served: Served, change: Any) -> None:
    answer = await served.ask("PATCH", "/users/ann/limits", "root", change)
    assert (answer.status, answer.body["field"]) == (400, next(iter(change)))


async def test_robots_and_connections_are_limited(served: Served) -> None:
    await served.master.limits.change("ann", {"robots": 1, "connections": 1})
    await served.robot("ann", "r1")
    with pytest.raises(AssertionError, match="robots: 2 with this one"):
        await served.robot("ann", "r2")
    await served.master.commands.execute("ann", m.CreateContainer("brain"))
    for tag in ("a", "b"):
        await served.master.commands.execute("ann", m.AddInterface("r1", tag, "SubscriberConverter", "std_msgs/String"))
        await served.master.commands.execute(
            "ann", m.AddInterface("brain", tag, "PublisherInterface", "std_msgs/String")
        )
    await served.master.commands.execute("ann", m.Connect("r1/a", "brain/a"))
    with pytest.raises(LimitExceeded, match="connections"):
        await served.master.commands.execute("ann", m.Connect("r1/b", "brain/b"))


# --- the audit log ----------------------------------------------------------------------------------------------------


async def audit(served: Served, user: str = "root", query: str = "") -> list[dict[str, Any]]:
    """The oldest first."""
    answer = await served.ask("GET", f"/audit?limit=1000{query}", user)
    assert answer.status == 200, answer.body
    found: list[dict[str, Any]] = answer.body["items"]
    return found[::-1]


async def test_audit_log_has_a_whole_session(served: Served) -> None:
    """Every change of a recorded session, and every refusal, by every door, and nothing else."""
    recorded: list[tuple[str, str, str, str, str]] = []

    async def rest(user: str, method: str, path: str, body: Any, action: str, thing: str, result: str = "ok") -> Answer:
        answer = await served.ask(method, path, user, body)
        assert (answer.status < 400) == (result == "ok"), answer.body
        recorded.append((user, action, thing, result, "rest"))
        return answer

    async def robot(call: Call[Any], action: str, thing: str, result: str = "ok", user: str = "ann") -> None:
        try:
            await served.call_master("west", call)
        except AssertionError:
            assert result != "ok"
        recorded.append((user, action, thing, result, "websocket"))

    await rest("root", "POST", "/users", {"name": "carl", "password": GOOD}, "user.create", "carl/user")
    made = await rest("ann", "POST", "/keys", {"label": "k", "role": "robot"}, "key.create", "ann/robot/k")
    name, secret = made.body["key"]["id"], made.body["secret"]
    await served.ask("GET", "/keys")  # to read is not noted
    await robot(Login("ann", "r1", secret), "robot.connect", "ann/r1")
    await robot(Login("ann", "r1", digest("wrong")), "robot.connect", "ann/r1", "unauthorized", user="")
    await robot(Login("vera", "r1", digest(PASSWORD)), "robot.connect", "vera/r1", "forbidden", user="vera")
    for command, action, thing, result in (
        (m.CreateContainer("e"), "environment.create", "ann/e", "ok"),
        (m.CreateContainer("e"), "environment.create", "ann/e", "already_exists"),
        (m.AddNode("e", "n", "p", "x"), "node.create", "ann/e/n", "ok"),
        (m.SetParameter("e", "rate", 1, "n"), "parameter.set", "ann/e/n/rate", "ok"),
        (m.AddInterface("e", "i", "PublisherInterface", "a/B"), "interface.create", "ann/e/i", "ok"),
        (m.AddInterface("r1", "i", "SubscriberConverter", "a/B"), "interface.create", "ann/r1/i", "ok"),
        (m.Connect("e/i", "r1/i"), "connection.create", "ann/e/i/r1/i", "ok"),
        (m.Disconnect("e/i", "r1/i"), "connection.remove", "ann/e/i/r1/i", "ok"),
        (m.DeleteParameter("e", "rate", "n"), "parameter.remove", "ann/e/n/rate", "ok"),
        (m.RemoveInterface("e", "i"), "interface.remove", "ann/e/i", "ok"),
        (m.RemoveNode("e", "n"), "node.remove", "ann/e/n", "ok"),
        (m.RemoveNode("e", "n"), "node.remove", "ann/e/n", "not_found"),
    ):
        await robot(Execute.of("ann/r1", command), action, thing, result)
    await rest("ann", "POST", "/environments", {"containerTag": "f"}, "environment.create", "ann/f")
    body = {"nodeTag": "n", "pkg": "p", "exe": "x"}
    await rest("ann", "POST", "/environments/f/nodes", body, "node.create", "ann/f/n")
    await rest("ann", "DELETE", "/environments/f/nodes/n", None, "node.remove", "ann/f/n")
    await rest("olga", "DELETE", "/environments/f?user=ann", None, "environment.remove", "ann/f")
    await rest("bob", "DELETE", "/environments/e?user=ann", None, "environment.remove", "ann/e", "not_found")
    await rest("vera", "POST", "/environments", {"containerTag": "g"}, "environment.create", "vera/g", "forbidden")
    await rest("ann", "GET", "/machines", None, "machine.read", "", "forbidden")
    await rest("root", "PATCH", "/users/ann/limits", {"robots": 9}, "limits.change", "ann")
    await rest("root", "PATCH", "/users/carl", {"role": "operator"}, "user.change", "carl/operator")
    change = {"new": GOOD, "old": PASSWORD}
    await rest("bob", "PUT", "/users/bob/password", change, "password.change", "bob")
    await rest("ann", "DELETE", "/robots/r1", None, "robot.disconnect", "ann/r1")
    await rest("ann", "POST", f"/keys/{name}/rotate", None, "key.rotate", f"ann/{name}")
    await rest("ann", "DELETE", f"/keys/{name}", None, "key.revoke", f"ann/{name}")
    await rest("root", "DELETE", "/users/carl", None, "user.remove", "carl")
    assert (await served.ask("GET", "/whoami", "eve")).status == 401
    recorded.append(("", "login", "eve", "unauthorized", "rest"))
    found = await audit(served)
    assert [tuple(each[field] for field in ("user", "action", "object", "result", "door")) for each in found] == (
        recorded
    )
    assert {each["address"] for each in found if each["door"] == "rest"} == {"127.0.0.1"}
    assert [each["key"] for each in found if each["action"] == "node.create"] == [name, ""]
    assert PASSWORD not in str(found)
    assert secret not in str(found)
    assert GOOD not in str(found)


async def test_audit_log_is_filtered_and_paged(served: Served) -> None:
    for number in range(3):
        await served.ask("POST", "/environments", "ann", {"containerTag": f"e{number}"})
    await served.ask("DELETE", "/environments/e1", "ann")
    await served.ask("DELETE", "/environments/e9", "ann")
    assert len(await audit(served, query="&object=ann/e1")) == 2
    assert len(await audit(served, query="&object=ann/e")) == 0  # the thing and what is below, no part of a name
    assert len(await audit(served, query="&object=ann")) == 5
    assert len(await audit(served, query="&action=environment.remove&result=ok")) == 1
    assert len(await audit(served, query="&user=bob")) == 0
    everything = await audit(served)
    assert len(await audit(served, query=f"&since={everything[2]['time']}&until={everything[4]['time']}")) == 2
    first = (await served.ask("GET", "/audit?limit=3", "root")).body
    rest = (await served.ask("GET", f"/audit?limit=3&after={first['next']}", "root")).body
    assert [*first["items"], *rest["items"]] == everything[::-1]
    assert rest["next"] == ""
    for query in ("after=x", "since=soon", "colour=red"):
        assert (await served.ask("GET", f"/audit?{query}", "root")).status == 400


async def test_users_see_their_part_of_the_audit_log(served: Served) -> None:
    await served.ask("POST", "/environments", "ann", {"containerTag": "e"})
    await served.ask("DELETE", "/environments/e?user=ann", "olga")
    await served.ask("DELETE", "/environments/e?user=ann", "bob")
    await served.ask("PATCH", "/users/bob/limits", "root", {"robots": 1})
    own = await audit(served, "ann")
    assert [(each["user"], each["address"]) for each in own] == [("ann", "127.0.0.1"), ("olga", ""), ("bob", "")]
    assert [each["action"] for each in await audit(served, "bob")] == ["environment.remove", "limits.change"]
    assert (await audit(served, "vera")) == []


async def test_failed_logins_do_not_fill_the_disk(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("master.access.audit.MAX_UNAUTHENTICATED", 4)
    for _ in range(6):
        await served.ask("GET", "/whoami", "eve")
    await served.ask("DELETE", "/environments/e", "ann")
    assert [each["action"] for each in await audit(served)] == ["login"] * 3 + ["environment.remove"]


async def test_old_audit_entries_are_removed(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    await served.ask("DELETE", "/environments/e", "ann")
    assert len(await audit(served)) == 1
    await served.master.audit.forget(0)
    await served.master.audit.forget(1)
    assert len(await audit(served)) == 1
    later = time.time() + 86_401
    monkeypatch.setattr(time, "time", lambda: later)
    await served.master.audit.forget(1)
    assert await audit(served) == []
