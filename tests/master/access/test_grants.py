"""Grants: temporary keys of services, and their end."""

from __future__ import annotations

import time
from typing import Any

import pytest
import sqlalchemy as sa

from master.access.rights import Principal
from master.access.users import Users, digest
from master.storage import tables as db
from master.storage.store import Store
from rce.errors import Unauthorized


async def test_temporary_key_has_the_role_robot(users: Users, store: Store) -> None:
    grant = await users.grants.give("maps", "ann", "")
    lent = await users.grants.issue_key("maps", grant, 60)
    assert lent.user == "ann"
    assert await users.check("ann", lent.key) == Principal("ann", "robot", lent=True)
    with pytest.raises(Unauthorized):
        await users.check("bob", lent.key)
    rows: list[Any] = await store.run(lambda connection: list(connection.execute(sa.select(db.grants))))
    assert lent.key not in repr(rows)
    assert digest(lent.key) in repr(rows)


async def test_new_temporary_key_replaces_the_one_before(users: Users) -> None:
    grant = await users.grants.give("maps", "ann", "")
    first = await users.grants.issue_key("maps", grant, 60)
    second = await users.grants.issue_key("maps", grant, 60)
    with pytest.raises(Unauthorized):
        await users.check("ann", first.key)
    assert await users.check("ann", second.key)


async def test_grant_is_valid_for_one_service(users: Users) -> None:
    grant = await users.grants.give("maps", "ann", "")
    await users.grants.end("others", grant)
    with pytest.raises(Unauthorized):
        await users.grants.issue_key("others", grant, 60)
    assert await users.grants.issue_key("maps", grant, 60)


async def test_end_of_a_grant_invalidates_its_key(users: Users) -> None:
    grant = await users.grants.give("maps", "ann", "")
    lent = await users.grants.issue_key("maps", grant, 60)
    for _ in range(2):
        await users.grants.end("maps", grant)
    with pytest.raises(Unauthorized):
        await users.check("ann", lent.key)
    with pytest.raises(Unauthorized):
        await users.grants.issue_key("maps", grant, 60)


@pytest.mark.parametrize("gone", ["user", "key"])
async def test_grant_ends_with_its_user_and_with_its_api_key(users: Users, gone: str) -> None:
    _, key = await users.keys.add("ann")
    grant = await users.grants.give("maps", "ann", key.id)
    lent = await users.grants.issue_key("maps", grant, 60)
    await (users.remove("ann") if gone == "user" else users.keys.revoke("ann", key.id))
    with pytest.raises(Unauthorized):
        await users.check("ann", lent.key)
    with pytest.raises(Unauthorized):
        await users.grants.issue_key("maps", grant, 60)
    with pytest.raises(Unauthorized):
        await users.grants.give("maps", "ann", key.id)


async def test_temporary_key_expires_with_its_time_and_its_api_key(
    users: Users, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = time.time()
    _, key = await users.keys.add("ann", expires=now + 1000)
    grant = await users.grants.give("maps", "ann", key.id)
    lent = await users.grants.issue_key("maps", grant, 100)
    longer = await users.grants.give("maps", "ann", key.id)
    long = await users.grants.issue_key("maps", longer, 5000)
    monkeypatch.setattr(time, "time", lambda: now + 101)
    with pytest.raises(Unauthorized):
        await users.check("ann", lent.key)
    assert await users.check("ann", long.key)
    monkeypatch.setattr(time, "time", lambda: now + 1001)
    with pytest.raises(Unauthorized):
        await users.check("ann", long.key)
    with pytest.raises(Unauthorized):
        await users.grants.issue_key("maps", longer, 100)
