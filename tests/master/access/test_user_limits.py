"""Limits in the database: the platform's, those of one user, and changes while the Master runs."""

from __future__ import annotations

import asyncio

import pytest
import sqlalchemy as sa
from msgspec import UNSET

from master.access import user_limits as module
from master.access.user_limits import UserLimits
from master.access.users import Users
from master.graph.limits import Policy
from master.storage.store import Store


async def test_changed_limits_override_those_of_the_platform(store: Store) -> None:
    limits = UserLimits(store, Policy(size=2, memory=100, images=["rce/base"]))
    await limits.open()
    await limits.change("ann", {"memory": 200, "images": ["mine/*"], "cpu": 1.5})
    assert limits.of("ann") == Policy(size=2, memory=200, cpu=1.5, images=["rce/base", "mine/*"])
    assert limits.of("bob") == Policy(size=2, memory=100, images=["rce/base"])
    await limits.change("ann", {"memory": None})
    assert limits.of("ann").memory is None
    await limits.change("ann", {"memory": UNSET, "images": UNSET, "cpu": UNSET})
    assert limits.of("ann") == limits.of("bob")


async def test_limits_of_users_survive_a_restart(store: Store) -> None:
    first = UserLimits(store, Policy(size=2))
    await first.open()
    await first.change("ann", {"memory": 200})
    second = UserLimits(store, Policy(size=3))
    await second.open()
    assert second.of("ann") == Policy(size=3, memory=200)


async def test_running_master_sees_changes_by_other_processes(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REFRESH", 0.001)
    running, other = UserLimits(store, Policy(size=2)), UserLimits(store)
    await running.open()
    await other.open()
    following = asyncio.create_task(running.follow())
    await other.change("ann", {"size": 5})

    async def seen() -> None:
        while running.of("ann").size != 5:  # noqa: ASYNC110  # what is looked at has no event of its own
            await asyncio.sleep(0.001)

    await asyncio.wait_for(seen(), 20)
    following.cancel()
    assert other.of("bob").size == 2


async def test_limits_are_removed_with_their_user(store: Store, users: Users) -> None:
    limits = UserLimits(store, Policy())
    await limits.open()
    await limits.change("ann", {"size": 5})
    await users.remove("ann")
    await limits.open()
    assert limits.of("ann") == Policy()


async def test_following_goes_on_after_a_database_failure(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    limits, tried = UserLimits(store), 0

    async def fail(work: object) -> None:
        nonlocal tried
        tried += 1
        if tried == 2:
            raise asyncio.CancelledError
        raise sa.exc.OperationalError("locked", None, Exception())

    monkeypatch.setattr(module, "REFRESH", 0)
    monkeypatch.setattr(store, "read", fail)
    with pytest.raises(asyncio.CancelledError):
        await limits.follow()
    assert tried == 2
