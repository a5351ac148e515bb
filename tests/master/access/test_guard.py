"""Guard: revoked credentials close what is open by them at once, and nothing else."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from functools import partial
from typing import NamedTuple

import argon2
import pytest
import sqlalchemy as sa

from master.access import guard as module
from master.access.guard import Guard
from master.access.users import Users, digest
from master.graph.effects import Plan, Send
from master.graph.records import Environment, EnvironmentOptions, Package, Process, Robot
from master.graph.state import State
from rce.api.roles import Principal
from rce.control.calls.call import Call
from rce.control.calls.joining import SetRemovedUsers
from rce.control.calls.robots import DropRobot
from rce.control.calls.services import InvalidateAuthentication
from rce.errors import InvalidRequest, NotFound, Unauthorized
from tests.support.master.database import open_store


class Place(NamedTuple):
    """Robots of ann by password, by keys k1 and k2, by temporary keys of a password and of k1; a feed of each."""

    users: Users
    state: State
    guard: Guard
    plans: list[Plan]
    closed: dict[str, str]
    k1: str
    k2: str
    secret1: str

    def robots(self) -> set[str]:
        return {robot.name.partition("/")[2] for robot in self.state.robots.by("ann")}

    def told(self) -> list[Call[object]]:
        return [step.call for plan in self.plans for steps in plan for step in steps if isinstance(step, Send)]


@pytest.fixture
async def place() -> AsyncIterator[Place]:
    store = await open_store()
    users = Users(store)
    users.passwords.hasher = argon2.PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)
    await users.add("ann", "secret")
    await users.add("root", "secret", "admin")
    (secret1, k1), (_, k2) = await users.keys.add("ann"), await users.keys.add("ann", "user")
    state, plans = State(), list[Plan]()
    for process in (Process("west", "robot", "1"), Process("maps", "service", "1")):
        state.processes.put(process)
        state.joined.add(process.name)
    guard = Guard(users, state, plans.append)
    closed: dict[str, str] = {}
    for tag, principal in (
        ("password", Principal("ann", "user")),
        ("k1", Principal("ann", "robot", k1.id)),
        ("k2", Principal("ann", "user", k2.id)),
        ("lent", Principal("ann", "robot", lent=True)),
        ("lent_by_k1", Principal("ann", "robot", k1.id, lent=True)),
    ):
        state.robots.put(Robot(f"ann/{tag}", "west", "", principal))
        guard.hold(principal, partial(closed.__setitem__, tag))
    state.robots.put(Robot("root/r", "west", ""))
    yield Place(users, state, guard, plans, closed, k1.id, k2.id, secret1)
    await store.close()


ALL = {"password", "k1", "k2", "lent", "lent_by_k1"}


@pytest.mark.parametrize(
    ("change", "gone"),
    [
        (lambda place: place.guard.revoke_key("ann", place.k1), {"k1", "lent_by_k1"}),
        (lambda place: place.guard.rotate_key("ann", place.k1), {"k1"}),
        (lambda place: place.guard.change_password("ann", "another one"), {"password", "lent"}),
        (lambda place: place.guard.change_role("ann", "viewer"), ALL),
        (lambda place: place.guard.change_role("ann", "admin"), {"password"}),
        (lambda place: place.guard.change_role("ann", "user"), set()),
        (lambda place: place.guard.remove_user("ann"), ALL),
        (lambda place: place.users.keys.revoke("ann", place.k2), {"k2"}),  # by another process
        (lambda place: place.users.remove("ann"), ALL),
    ],
)
async def test_connections_with_invalid_credentials_are_closed(
    place: Place, change: Callable[[Place], Awaitable[object]], gone: set[str]
) -> None:
    await change(place)
    await place.guard.check_all()
    assert place.robots() == ALL - gone
    assert set(place.closed) == gone
    dropped = [call.robot for call in place.told() if isinstance(call, DropRobot)]
    assert sorted(dropped) == sorted(f"ann/{tag}" for tag in gone)
    assert "root/r" not in dropped


async def test_services_drop_cached_authentications(place: Place) -> None:
    await place.guard.revoke_key("ann", place.k1)
    assert InvalidateAuthentication("ann") in place.told()


async def test_released_connections_are_not_closed(place: Place) -> None:
    release = place.guard.hold(Principal("ann", "robot", place.k1), lambda reason: pytest.fail(reason))
    release()
    release()
    await place.guard.revoke_key("ann", place.k1)


async def test_expired_key_closes_its_connections(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    _, key = await place.users.keys.add("ann", expires=time.time() + 100)
    place.state.robots.put(Robot("ann/short", "west", "", Principal("ann", "robot", key.id)))
    await place.guard.check_all()
    assert "short" in place.robots()
    later = time.time() + 101
    monkeypatch.setattr(time, "time", lambda: later)
    await place.guard.check_all()
    assert place.robots() == ALL


async def test_robot_is_disconnected_when_its_endpoint_is_back(place: Place) -> None:
    place.state.joined.discard("west")
    await place.guard.revoke_key("ann", place.k1)
    assert "k1" not in place.robots()  # so that the endpoint's Sync lacks it
    assert not [call for call in place.told() if isinstance(call, DropRobot)]


async def test_removed_user_leaves_nothing(place: Place) -> None:
    place.state.environments.put(Environment("ann/e", EnvironmentOptions(), "0", ""))
    place.state.packages.put(Package("ann/p"))
    place.state.packages.put(Package("root/q", [], ["ann", "bob"]))
    await place.guard.remove_user("ann")
    assert not place.state.environments.by("ann")
    assert [(each.name, each.shared) for each in place.state.packages] == [("root/q", ["bob"])]
    with pytest.raises(NotFound):
        await place.guard.remove_user("ann")


async def test_last_administrator_cannot_be_removed(place: Place) -> None:
    for change in (place.guard.remove_user("root"), place.guard.change_role("root", "user")):
        with pytest.raises(InvalidRequest, match="last administrator"):
            await change
    await place.users.add("boss", "secret", "admin")
    await place.guard.remove_user("root")


async def test_rotated_key_has_a_new_secret_and_keeps_the_rest(place: Place) -> None:
    fresh, key = await place.guard.rotate_key("ann", place.k1)
    assert key.id == place.k1
    with pytest.raises(Unauthorized):
        await place.users.check("ann", place.secret1)
    assert (await place.users.check("ann", fresh)).key == place.k1


async def test_changed_password_replaces_the_old_one(place: Place) -> None:
    await place.guard.change_password("ann", "another one")
    with pytest.raises(Unauthorized):
        await place.users.check("ann", digest("secret"))
    assert await place.users.check("ann", digest("another one")) == Principal("ann", "user")


async def test_check_that_overlaps_a_password_change_fails(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    verify = place.users.passwords.verify

    async def slow(hashed: str | None, secret: str) -> bool:
        good = await verify(hashed, secret)
        await place.guard.change_password("ann", "another one")
        return good

    monkeypatch.setattr(place.users.passwords, "verify", slow)
    with pytest.raises(Unauthorized):
        await place.users.check("ann", digest("secret"))


async def test_demotion_removes_keys_beyond_the_new_role(place: Place) -> None:
    await place.guard.change_role("ann", "robot")
    assert [key.id for key in await place.users.keys.of("ann")] == [place.k1]
    assert (await place.users.check("", place.secret1)).role == "robot"


async def test_last_use_of_a_key_is_stored_at_the_next_check(place: Place) -> None:
    before = time.time()
    await place.users.check("", place.secret1)
    for _ in range(2):  # from memory, then from the database
        used = {key.id: key.used for key in await place.users.keys.of("ann")}
        assert used[place.k2] is None
        assert before <= (used[place.k1] or 0.0) <= time.time()
        await place.guard.check_all()


async def test_checks_go_on_after_a_database_failure(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = asyncio.Event()

    async def fails() -> None:
        if seen.is_set():
            raise asyncio.CancelledError
        seen.set()
        raise sa.exc.OperationalError("locked", None, Exception())

    monkeypatch.setattr(module, "REFRESH", 0)
    monkeypatch.setattr(place.guard, "check_all", fails)
    with pytest.raises(asyncio.CancelledError):
        await place.guard.follow()


async def test_processes_are_told_who_was_removed(place: Place) -> None:
    place.state.processes.put(Process("m1", "container", "1"))
    place.state.joined.add("m1")
    await place.guard.remove_user("ann")
    told = {
        step.to: step.call.users
        for plan in place.plans
        for steps in plan
        for step in steps
        if isinstance(step, Send) and isinstance(step.call, SetRemovedUsers)
    }
    assert told.keys() == {"maps", "m1"}
    first = told["maps"]["ann"]
    await place.users.add("ann", "secret")
    await place.users.remove("ann")  # by another process
    await place.guard.check_all()
    assert place.state.removed_users["ann"] > first


async def test_removal_of_a_user_who_does_not_exist_is_not_noted(place: Place) -> None:
    with pytest.raises(NotFound):
        await place.guard.remove_user("nobody")
    assert await place.users.removals() == {}
