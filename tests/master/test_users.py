"""Users, passwords, API keys, and the tokens of processes."""

from __future__ import annotations

from typing import Any

import pytest
import sqlalchemy as sa
from msgspec.structs import replace

from master import keys as module
from master import store as db
from master.processes import Processes
from master.rights import Principal
from master.store import Store
from master.users import Users, digest, must_drive
from rce.errors import AlreadyExists, Forbidden, InvalidName, InvalidRequest, NotFound, RceError, Unauthorized
from rce.roles import UserRole


@pytest.fixture
def processes(store: Store) -> Processes:
    return Processes(store)


async def contents(store: Store) -> str:
    """All that the database holds, as text."""
    rows: list[Any] = []
    for table in db.tables.sorted_tables:
        rows += await store.run(lambda connection, table=table: list(connection.execute(sa.select(table))))  # type: ignore[misc]
    return repr(rows)


# --- passwords --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("secret", [digest("secret"), digest("secret").upper()])
async def test_the_sha256_of_the_password_is_let_in(users: Users, secret: str) -> None:
    assert await users.check("ann", secret) == Principal("ann", "user")


@pytest.mark.parametrize(
    ("name", "secret"),
    [
        ("ann", "secret"),  # clear
        ("ann", digest("Secret")),
        ("ann", ""),
        ("ann", "rce_" + "0" * 40),
        ("bob", digest("secret")),
        ("", digest("secret")),
        ("ann' OR 1=1 --", digest("secret")),
        ("ann", digest("secret") + "\x00"),
    ],
)
async def test_all_else_is_not(users: Users, name: str, secret: str) -> None:
    with pytest.raises(Unauthorized):
        await users.check(name, secret)


async def test_no_secret_stands_in_the_database(users: Users, store: Store, processes: Processes) -> None:
    key, _ = await users.keys.add("ann")
    await processes.allow("west", "robot", "join token")
    credential = await processes.admit("west", "robot", "join token")
    kept = await contents(store)
    for secret in ("secret'", digest("secret"), key, "join token", credential):
        assert secret not in kept
    assert "argon2id" in kept


async def test_names_of_users(users: Users) -> None:
    await users.add("Bob_2", "x", "admin")
    assert await users.names() == ["Bob_2", "ann"]
    with pytest.raises(AlreadyExists):
        await users.add("ann", "other")
    with pytest.raises(InvalidName):
        await users.add("a/b", "x")
    with pytest.raises(NotFound):
        await users.remove("nobody")


async def test_a_removed_user_and_its_keys_are_out(users: Users, store: Store) -> None:
    key, _ = await users.keys.add("ann")
    await users.remove("ann")
    for secret in (digest("secret"), key):
        with pytest.raises(Unauthorized):
            await users.check("ann", secret)
    assert await contents(store) == "[]"


# --- API keys ---------------------------------------------------------------------------------------------------------


async def test_a_key_is_let_in_with_its_role_until_it_is_revoked(users: Users) -> None:
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


async def test_a_key_is_of_one_user(users: Users) -> None:
    await users.add("bob", "x")
    secret, key = await users.keys.add("ann")
    with pytest.raises(Unauthorized):
        await users.check("bob", secret)
    with pytest.raises(NotFound):
        await users.keys.revoke("bob", key.id)
    with pytest.raises(NotFound):
        await users.keys.add("nobody")


async def test_a_key_expires(users: Users, monkeypatch: pytest.MonkeyPatch) -> None:
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
def test_who_may_connect_as_a_robot(role: UserRole, error: type[RceError] | None) -> None:
    if error is None:
        must_drive(Principal("ann", role))
    else:
        with pytest.raises(error):
            must_drive(Principal("ann", role))


# --- processes --------------------------------------------------------------------------------------------------------


async def test_a_token_is_good_once_and_its_credential_from_then_on(processes: Processes) -> None:
    await processes.allow("west", "robot", "t")
    credential = await processes.admit("west", "robot", "t")
    assert await processes.admit("west", "robot", credential) == credential
    with pytest.raises(Unauthorized):
        await processes.admit("west", "robot", "t")
    await processes.allow("west", "robot", "t")  # as at each start of a Master with this token in its settings
    with pytest.raises(Unauthorized):
        await processes.admit("west", "robot", "t")


@pytest.mark.parametrize(
    ("process", "role", "secret"),
    [("east", "robot", "t"), ("west", "container", "t"), ("west", "robot", "u"), ("west", "robot", ""), ("", "", "")],
)
async def test_a_token_is_for_one_process_in_one_role(
    processes: Processes, process: str, role: str, secret: str
) -> None:
    await processes.allow("west", "robot", "t")
    with pytest.raises(Unauthorized):
        await processes.admit(process, role, secret)
    assert await processes.admit("west", "robot", "t")


async def test_a_credential_is_for_one_role(processes: Processes) -> None:
    await processes.allow("west", "robot", "t")
    credential = await processes.admit("west", "robot", "t")
    with pytest.raises(Unauthorized):
        await processes.admit("west", "container", credential)


async def test_a_new_token_replaces_the_credential(processes: Processes) -> None:
    await processes.allow("west", "robot", "t")
    old = await processes.admit("west", "robot", "t")
    await processes.allow("west", "robot", "u")
    new = await processes.admit("west", "robot", "u")
    with pytest.raises(Unauthorized):
        await processes.admit("west", "robot", old)
    assert await processes.admit("west", "robot", new) == new


async def test_who_is_forgotten_joins_no_more(processes: Processes) -> None:
    await processes.allow("west", "robot", "t")
    credential = await processes.admit("west", "robot", "t")
    await processes.allow("west", "robot", "unused")
    await processes.forget("west")
    for secret in (credential, "t", "unused"):
        with pytest.raises(Unauthorized):
            await processes.admit("west", "robot", secret)
