"""Users, passwords, API keys, and join tokens of processes."""

from __future__ import annotations

from typing import Any

import pytest
import sqlalchemy as sa
from msgspec.structs import replace

from master.access import keys as module
from master.access.join_tokens import JoinTokens
from master.access.rights import Principal
from master.access.users import Users, check_robot_login, digest
from master.storage import tables as db
from master.storage.store import Store
from rce.api.roles import UserRole
from rce.errors import AlreadyExists, Forbidden, InvalidName, InvalidRequest, NotFound, RceError, Unauthorized


@pytest.fixture
def processes(store: Store) -> JoinTokens:
    return JoinTokens(store)


async def contents(store: Store) -> str:
    """Return the whole contents of the database as text."""
    rows: list[Any] = []
    for table in db.tables.sorted_tables:
        rows += await store.run(lambda connection, table=table: list(connection.execute(sa.select(table))))  # type: ignore[misc]
    return repr(rows)


# --- passwords --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("secret", [digest("secret"), digest("secret").upper()])
async def test_sha256_of_the_password_authenticates(users: Users, secret: str) -> None:
    assert await users.check("ann", secret) == Principal("ann", "user")


@pytest.mark.parametrize(
    ("name", "secret"),
    [
        ("ann", "secret"),  # plain text
        ("ann", digest("Secret")),
        ("ann", ""),
        ("ann", "rce_" + "0" * 40),
        ("bob", digest("secret")),
        ("", digest("secret")),
        ("ann' OR 1=1 --", digest("secret")),
        ("ann", digest("secret") + "\x00"),
    ],
)
async def test_other_secrets_are_refused(users: Users, name: str, secret: str) -> None:
    with pytest.raises(Unauthorized):
        await users.check(name, secret)


async def test_database_contains_no_secrets(users: Users, store: Store, processes: JoinTokens) -> None:
    key, _ = await users.keys.add("ann")
    await processes.allow("west", "robot", "join token")
    credential = await processes.admit("west", "robot", "join token")
    kept = await contents(store)
    for secret in ("secret'", digest("secret"), key, "join token", credential):
        assert secret not in kept
    assert "argon2id" in kept


async def test_names_of_users_are_checked(users: Users) -> None:
    await users.add("Bob_2", "x", "admin")
    assert await users.names() == ["Bob_2", "ann"]
    with pytest.raises(AlreadyExists):
        await users.add("ann", "other")
    with pytest.raises(InvalidName):
        await users.add("a/b", "x")
    with pytest.raises(NotFound):
        await users.remove("nobody")


async def test_removed_user_cannot_authenticate(users: Users, store: Store) -> None:
    key, _ = await users.keys.add("ann")
    await users.remove("ann")
    for secret in (digest("secret"), key):
        with pytest.raises(Unauthorized):
            await users.check("ann", secret)
    assert await contents(store) == "[]"


# --- API keys ---------------------------------------------------------------------------------------------------------


async def test_key_authenticates_until_it_is_revoked(users: Users) -> None:
    secret, key = await users.keys.add("ann", "viewer", "dashboard")
    assert await users.check("ann", secret) == Principal("ann", "viewer", key.id)
    (seen,) = await users.keys.of("ann")
    assert seen == replace(key, used=seen.used)
    assert secret not in repr(key)
    await users.keys.revoke("ann", key.id)
    with pytest.raises(Unauthorized):
        await users.check("ann", secret)
    with pytest.raises(NotFound):
        await users.keys.revoke("ann", key.id)


async def test_key_belongs_to_one_user(users: Users) -> None:
    await users.add("bob", "x")
    secret, key = await users.keys.add("ann")
    with pytest.raises(Unauthorized):
        await users.check("bob", secret)
    with pytest.raises(NotFound):
        await users.keys.revoke("bob", key.id)
    with pytest.raises(NotFound):
        await users.keys.add("nobody")


async def test_expired_key_is_refused(users: Users, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1000.0
    monkeypatch.setattr(module.time, "time", lambda: now)
    secret, _ = await users.keys.add("ann", expires=1060)
    now = 1059.9
    assert (await users.check("ann", secret)).role == "robot"
    now = 1060.1
    with pytest.raises(Unauthorized):
        await users.check("ann", secret)


@pytest.mark.parametrize(
    ("role", "error"),
    [("user", None), ("robot", None), ("operator", None), ("viewer", Forbidden), ("admin", InvalidRequest)],
)
def test_roles_that_may_connect_as_a_robot(role: UserRole, error: type[RceError] | None) -> None:
    if error is None:
        check_robot_login(Principal("ann", role))
    else:
        with pytest.raises(error):
            check_robot_login(Principal("ann", role))


# --- processes --------------------------------------------------------------------------------------------------------


async def test_token_is_exchanged_once_for_a_credential(processes: JoinTokens) -> None:
    await processes.allow("west", "robot", "t")
    credential = await processes.admit("west", "robot", "t")
    assert await processes.admit("west", "robot", credential) == credential
    with pytest.raises(Unauthorized):
        await processes.admit("west", "robot", "t")
    await processes.allow("west", "robot", "t")  # as a Master does at each start with this token in its settings
    with pytest.raises(Unauthorized):
        await processes.admit("west", "robot", "t")


@pytest.mark.parametrize(
    ("process", "role", "secret"),
    [("east", "robot", "t"), ("west", "container", "t"), ("west", "robot", "u"), ("west", "robot", ""), ("", "", "")],
)
async def test_token_is_for_one_process_and_role(processes: JoinTokens, process: str, role: str, secret: str) -> None:
    await processes.allow("west", "robot", "t")
    with pytest.raises(Unauthorized):
        await processes.admit(process, role, secret)
    assert await processes.admit("west", "robot", "t")


async def test_credential_is_for_one_role(processes: JoinTokens) -> None:
    await processes.allow("west", "robot", "t")
    credential = await processes.admit("west", "robot", "t")
    with pytest.raises(Unauthorized):
        await processes.admit("west", "container", credential)


async def test_new_token_replaces_the_credential(processes: JoinTokens) -> None:
    await processes.allow("west", "robot", "t")
    old = await processes.admit("west", "robot", "t")
    await processes.allow("west", "robot", "u")
    new = await processes.admit("west", "robot", "u")
    with pytest.raises(Unauthorized):
        await processes.admit("west", "robot", old)
    assert await processes.admit("west", "robot", new) == new


async def test_forgotten_process_cannot_join(processes: JoinTokens) -> None:
    await processes.allow("west", "robot", "t")
    credential = await processes.admit("west", "robot", "t")
    await processes.allow("west", "robot", "unused")
    await processes.forget("west")
    for secret in (credential, "t", "unused"):
        with pytest.raises(Unauthorized):
            await processes.admit("west", "robot", secret)
