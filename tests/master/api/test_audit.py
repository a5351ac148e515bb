"""The audit log over HTTP: what a session leaves in it, filters and pages, and who sees what."""

from __future__ import annotations

from typing import Any

from master.access.users import digest
from rce.control.calls.call import Call
from rce.control.calls.robots import Execute, Login
from rce.errors import RceError
from rce.protocol import messages as m
from tests.support.master.served import PASSWORD, Answer, Served

GOOD = "correct horse battery"


async def audit(served: Served, user: str = "root", query: str = "") -> list[dict[str, Any]]:
    """Return the entries that a user sees, the oldest first."""
    answer = await served.ask("GET", f"/audit?limit=1000{query}", user)
    assert answer.status == 200, answer.body
    found: list[dict[str, Any]] = answer.body["items"]
    return found[::-1]


async def test_audit_log_has_a_whole_session(served: Served) -> None:
    """Every change of a recorded session, and every refusal, by every interface of the platform, and nothing else."""
    recorded: list[tuple[str, str, str, str, str]] = []

    async def rest(user: str, method: str, path: str, body: Any, action: str, thing: str, result: str = "ok") -> Answer:
        answer = await served.ask(method, path, user, body)
        assert (answer.status < 400) == (result == "ok"), answer.body
        recorded.append((user, action, thing, result, "rest"))
        return answer

    async def robot(call: Call[Any], action: str, thing: str, result: str = "ok", user: str = "ann") -> None:
        try:
            await served.call_master("west", call)
        except (AssertionError, RceError):  # of one of the commands, or of the call
            assert result != "ok"
        recorded.append((user, action, thing, result, "websocket"))

    await rest("root", "POST", "/users", {"name": "carl", "password": GOOD}, "user.create", "carl/user")
    made = await rest("ann", "POST", "/keys", {"label": "k", "role": "robot"}, "key.create", "ann/robot/k")
    name, secret = made.body["key"]["id"], made.body["secret"]
    await served.ask("GET", "/keys")  # reading is not recorded
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
