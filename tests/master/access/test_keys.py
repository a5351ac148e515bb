"""API keys: made for a role and its scopes, used, rotated and revoked."""

from __future__ import annotations

import time
from typing import get_args

import pytest
import sqlalchemy as sa
from msgspec.structs import replace

from master.access import keys as module
from master.access.users import Users
from master.storage.store import Store
from rce.api.roles import ASSIGNABLE_ROLES, Principal, Scopes, UserRole
from rce.errors import Forbidden, InvalidName, InvalidRequest, LimitExceeded, NotFound, RceError, Unauthorized


async def test_key_authenticates_until_it_is_revoked(users: Users) -> None:
    secret, key = await users.keys.add("ann", "viewer", "dashboard")
    assert await users.keys.check("ann", secret) == Principal("ann", "viewer", key.id)
    (seen,) = await users.keys.of("ann")
    assert seen == replace(key, used=seen.used)
    assert secret not in repr(key)
    await users.keys.revoke("ann", key.id)
    with pytest.raises(Unauthorized):
        await users.keys.check("ann", secret)
    with pytest.raises(NotFound):
        await users.keys.revoke("ann", key.id)


async def test_key_identifies_its_user(users: Users) -> None:
    secret, key = await users.keys.add("ann", "user")
    assert await users.keys.check("", secret) == Principal("ann", "user", key.id)


async def test_key_belongs_to_one_user(users: Users) -> None:
    await users.add("bob", "x")
    secret, key = await users.keys.add("ann")
    with pytest.raises(Unauthorized):
        await users.keys.check("bob", secret)
    for action in (users.keys.revoke, users.keys.get, users.keys.rotate):
        with pytest.raises(NotFound) as raised:
            await action("bob", key.id)
        assert raised.value.field == "key"
    assert await users.keys.check("ann", secret)
    with pytest.raises(NotFound):
        await users.keys.add("nobody")


async def test_rotated_key_has_a_new_secret_and_keeps_the_rest(users: Users) -> None:
    scopes = Scopes("r1", ["e"])
    old, key = await users.keys.add("ann", "robot", "r1", time.time() + 1000, scopes)
    new, rotated = await users.keys.rotate("ann", key.id)
    assert rotated == key
    assert await users.keys.check("ann", new) == Principal("ann", "robot", key.id, scopes=scopes)
    with pytest.raises(Unauthorized):
        await users.keys.check("ann", old)


async def test_expired_key_is_refused(users: Users, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1000.0
    monkeypatch.setattr(time, "time", lambda: now)
    secret, _ = await users.keys.add("ann", expires=1060)
    now = 1059.9
    assert (await users.keys.check("ann", secret)).role == "robot"
    now = 1060.1
    with pytest.raises(Unauthorized):
        await users.keys.check("ann", secret)


@pytest.mark.parametrize("role", get_args(UserRole))
async def test_key_cannot_exceed_the_role_of_its_user(users: Users, role: UserRole) -> None:
    await users.add("bob", "x", role)
    for wanted in get_args(UserRole):
        if wanted in ASSIGNABLE_ROLES[role]:
            assert (await users.keys.add("bob", wanted))[1].role == wanted
        else:
            with pytest.raises(Forbidden) as raised:
                await users.keys.add("bob", wanted)
            assert raised.value.field == "role"


async def test_key_beyond_the_present_role_of_its_user_is_refused(users: Users, store: Store) -> None:
    """Another process may have changed the role without removing the keys."""
    secret, _ = await users.keys.add("ann", "user")
    await store.run(lambda connection: connection.execute(sa.text("UPDATE users SET role = 'viewer'")))
    with pytest.raises(Unauthorized, match="its user's is viewer now"):
        await users.keys.check("ann", secret)


@pytest.mark.parametrize(
    ("role", "scopes", "error", "field"),
    [
        ("user", Scopes("r1"), InvalidRequest, "scopes"),
        ("user", Scopes(environments=["e"]), InvalidRequest, "scopes"),
        ("robot", Scopes(metrics=True), InvalidRequest, "scopes.metrics"),
        ("robot", Scopes("no/name"), InvalidName, "scopes.robot"),
        ("robot", Scopes(environments=["e", ""]), InvalidName, "scopes.environments"),
    ],
)
async def test_scopes_must_fit_the_role(
    users: Users, role: UserRole, scopes: Scopes, error: type[RceError], field: str
) -> None:
    await users.add("root", "x", "admin")
    with pytest.raises(error) as raised:
        await users.keys.add("root", role, scopes=scopes)
    assert raised.value.info.field == field
    assert await users.keys.all() == []


async def test_scopes_are_part_of_the_identity(users: Users) -> None:
    await users.add("root", "x", "admin")
    wanted: list[tuple[UserRole, Scopes]] = [("robot", Scopes("r1", ["e"])), ("operator", Scopes(metrics=True))]
    for role, scopes in wanted:
        secret, _ = await users.keys.add("root", role, scopes=scopes)
        assert (await users.keys.check("root", secret)).scopes == scopes


async def test_number_of_keys_is_limited(users: Users, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_KEYS", 2)
    await users.add("bob", "x")
    keys = [await users.keys.add("ann") for _ in range(2)]
    with pytest.raises(LimitExceeded):
        await users.keys.add("ann")
    await users.keys.add("bob")
    await users.keys.revoke("ann", keys[0][1].id)
    await users.keys.add("ann")


async def test_keys_are_listed_oldest_first(users: Users, monkeypatch: pytest.MonkeyPatch) -> None:
    await users.add("bob", "x")
    for now, user in enumerate(("bob", "ann", "bob", "ann")):
        monkeypatch.setattr(time, "time", lambda now=now: float(now))
        await users.keys.add(user, label=str(now))
    assert [key.label for key in await users.keys.of("ann")] == ["1", "3"]
    assert [key.label for key in await users.keys.all()] == ["1", "3", "0", "2"]
    assert await users.keys.of("nobody") == []


async def test_last_use_is_kept_when_it_cannot_be_stored(
    users: Users, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    secret, key = await users.keys.add("ann")
    await users.keys.check("ann", secret)

    async def fail(work: object) -> None:
        raise sa.exc.OperationalError("locked", None, Exception())

    with monkeypatch.context() as patched:
        patched.setattr(store, "run", fail)
        with pytest.raises(sa.exc.OperationalError):
            await users.keys.note_use()
    await users.keys.note_use()
    assert (await Users(store).keys.get("ann", key.id)).used is not None


async def test_key_that_a_key_makes_ends_with_it(users: Users, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1000.0
    monkeypatch.setattr(time, "time", lambda: now)
    _, parent = await users.keys.add("ann", "user", expires=2000)
    for wanted, expires in ((None, 2000), (1500, 1500), (2000, 2000)):
        _, child = await users.keys.add("ann", expires=wanted, parent=parent.id)
        assert (child.expires, child.parent) == (expires, parent.id)
        assert child in await users.keys.of("ann")
    with pytest.raises(Forbidden) as raised:
        await users.keys.add("ann", expires=2001, parent=parent.id)
    assert raised.value.field == "expires"
    _, forever = await users.keys.add("ann", "user")
    assert (await users.keys.add("ann", expires=9e9, parent=forever.id))[1].expires == 9e9


async def test_revoked_key_takes_along_the_keys_that_were_made_with_it(users: Users) -> None:
    await users.add("bob", "x")
    _, parent = await users.keys.add("ann", "user")
    _, child = await users.keys.add("ann", "user", parent=parent.id)
    grandchild, _ = await users.keys.add("bob", parent=child.id)
    _, other = await users.keys.add("ann")
    assert await users.keys.revoke("ann", parent.id) == {"ann", "bob"}
    assert [key.id for key in await users.keys.all()] == [other.id]
    with pytest.raises(Unauthorized):
        await users.keys.check("", grandchild)
    with pytest.raises(Unauthorized):  # a request that was under way
        await users.keys.add("ann", parent=parent.id)


async def test_key_rotates_itself_and_what_was_made_with_it(users: Users) -> None:
    _, parent = await users.keys.add("ann", "user")
    _, child = await users.keys.add("ann", "user", parent=parent.id)
    _, grandchild = await users.keys.add("ann", parent=child.id)
    for target, by in ((parent, parent), (child, parent), (grandchild, parent), (grandchild, child)):
        await users.keys.rotate("ann", target.id, by.id)
    _, other = await users.keys.add("ann")
    for target, by in ((parent, child), (other, parent), (parent, other)):
        with pytest.raises(Forbidden, match="with your password"):
            await users.keys.rotate("ann", target.id, by.id)
    await users.keys.rotate("ann", other.id)
