"""What a service may do for a user: as much as was given, as long as it holds."""

from __future__ import annotations

import time
from typing import Any

import pytest
import sqlalchemy as sa

from master import grants as module
from master import store as db
from master.rights import Principal
from master.store import Store
from master.users import Users, digest
from rce.errors import Unauthorized


async def test_a_lent_key_is_a_robots(users: Users, store: Store) -> None:
    grant = await users.grants.give("maps", "ann", "")
    lent = await users.grants.borrow("maps", grant, 60)
    assert lent.user == "ann"
    assert await users.check("ann", lent.key) == Principal("ann", "robot", lent=True)
    with pytest.raises(Unauthorized):
        await users.check("bob", lent.key)
    rows: list[Any] = await store.run(lambda connection: list(connection.execute(sa.select(db.grants))))
    assert lent.key not in repr(rows)
    assert digest(lent.key) in repr(rows)


async def test_there_is_one_key_at_a_time(users: Users) -> None:
    grant = await users.grants.give("maps", "ann", "")
    first = await users.grants.borrow("maps", grant, 60)
    second = await users.grants.borrow("maps", grant, 60)
    with pytest.raises(Unauthorized):
        await users.check("ann", first.key)
    assert await users.check("ann", second.key)


async def test_a_grant_is_one_services(users: Users) -> None:
    grant = await users.grants.give("maps", "ann", "")
    await users.grants.end("others", grant)
    with pytest.raises(Unauthorized):
        await users.grants.borrow("others", grant, 60)
    assert await users.grants.borrow("maps", grant, 60)


async def test_the_end_of_a_grant_is_that_of_its_key(users: Users) -> None:
    grant = await users.grants.give("maps", "ann", "")
    lent = await users.grants.borrow("maps", grant, 60)
    for _ in range(2):
        await users.grants.end("maps", grant)
    with pytest.raises(Unauthorized):
        await users.check("ann", lent.key)
    with pytest.raises(Unauthorized):
        await users.grants.borrow("maps", grant, 60)


@pytest.mark.parametrize("gone", ["user", "key"])
async def test_a_grant_ends_with_the_user_and_with_the_key_that_it_was_given_with(users: Users, gone: str) -> None:
    _, key = await users.keys.add("ann")
    grant = await users.grants.give("maps", "ann", key.id)
    lent = await users.grants.borrow("maps", grant, 60)
    await (users.remove("ann") if gone == "user" else users.keys.revoke("ann", key.id))
    with pytest.raises(Unauthorized):
        await users.check("ann", lent.key)
    with pytest.raises(Unauthorized):
        await users.grants.borrow("maps", grant, 60)
    with pytest.raises(Unauthorized):
        await users.grants.give("maps", "ann", key.id)


async def test_time_ends_a_lent_key_and_the_key_behind_it(users: Users, monkeypatch: pytest.MonkeyPatch) -> None:
    now = time.time()
    _, key = await users.keys.add("ann", expires=now + 1000)
    grant = await users.grants.give("maps", "ann", key.id)
    lent = await users.grants.borrow("maps", grant, 100)
    longer = await users.grants.give("maps", "ann", key.id)
    long = await users.grants.borrow("maps", longer, 5000)
    monkeypatch.setattr(module.time, "time", lambda: now + 101)
    with pytest.raises(Unauthorized):
        await users.check("ann", lent.key)
    assert await users.check("ann", long.key)
    monkeypatch.setattr(module.time, "time", lambda: now + 1001)
    with pytest.raises(Unauthorized):
        await users.check("ann", long.key)
    with pytest.raises(Unauthorized):
        await users.grants.borrow("maps", longer, 100)


async def test_a_key_knows_its_user(users: Users) -> None:
    secret, _ = await users.keys.add("ann", "user")
    assert (await users.check("", secret)).user == "ann"
