"""Users with their passwords and limits over HTTP."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from twisted.internet.base import ReactorBase

from master.access.throttle import Throttle
from master.graph.limits import Policy
from rce.control.calls.environments import StopEnvironment
from rce.control.calls.robots import DropRobot
from rce.errors import LimitExceeded
from rce.protocol import messages as m
from tests.support.master.api_keys import ask_by_key, make_key
from tests.support.master.served import PASSWORD, Served, serve

GOOD = "correct horse battery"


@pytest.fixture
async def served(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[Served]:
    async with serve(reactor, tmp_path, Policy(environments=3)) as served:
        yield served


# --- users ------------------------------------------------------------------------------------------------------------


async def test_administrator_creates_changes_and_removes_users(served: Served) -> None:
    made = await served.ask("POST", "/users", "root", {"name": "carl", "password": GOOD})
    assert (made.status, made.body["role"]) == (201, "user")
    assert (await served.ask("GET", "/users/carl", "carl", secret=GOOD)).body == made.body
    assert (await served.ask("POST", "/users", "root", {"name": "carl", "password": GOOD})).status == 409
    _, secret = await make_key(served, "root", role="robot")
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
    assert (await ask_by_key(served, secret, "GET", "/robots")).status == 200


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
    name, secret = await make_key(served)
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
    assert (await ask_by_key(served, secret, "GET", f"/keys/{name}")).status == 200
    assert (await served.ask("PUT", "/users/ann/password", "root", {"new": GOOD + "!"})).status == 204
    assert (await served.ask("PUT", "/users/root/password", "root", {"new": GOOD})).status == 403
    for other in ("bob", "nobody"):
        assert (await served.ask("PUT", f"/users/{other}/password", "olga", {"new": GOOD})).status == 404


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
    await served.ask("PATCH", "/users/ann/limits", "root", {"environments": None, "total_bandwidth": "", "memory": "-"})
    assert (await served.ask("POST", "/environments", "ann", {"containerTag": "more"})).status == 201
    assert (await served.ask("GET", "/users/bob/usage", "ann")).status == 404
    assert (await served.ask("GET", "/users/nobody/usage", "root")).status == 404


@pytest.mark.parametrize("zero", [0, "0"])
async def test_limit_of_zero_is_zero(served: Served, zero: Any) -> None:
    changed = await served.ask("PATCH", "/users/ann/limits", "root", {"environments": zero, "robots": None})
    assert (changed.body["environments"], changed.body["robots"], changed.body["memory"]) == (0, None, None)
    refused = await served.ask("POST", "/environments", "ann", {"containerTag": "brain"})
    assert (refused.status, refused.body["fields"]["limit"]) == (413, 0)


@pytest.mark.parametrize("change", [{"memory": "lots"}, {"memory": -1}, {"wings": 2}, {"robots": [1]}, {"egress": "x"}])
async def test_wrong_limits_are_refused(served: Served, change: Any) -> None:
    answer = await served.ask("PATCH", "/users/ann/limits", "root", change)
    assert (answer.status, answer.body["field"]) == (400, next(iter(change)))


async def test_robots_and_connections_are_limited(served: Served) -> None:
    await served.master.limits.change("ann", {"robots": 1, "connections": 1})
    await served.robot("ann", "r1")
    with pytest.raises(LimitExceeded, match="robots: 2 with this one"):
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
