"""Users: their names, roles and passwords, and what authenticates them."""

from __future__ import annotations

import time
from typing import Any

import pytest
import sqlalchemy as sa

from master.access.join_tokens import JoinTokens
from master.access.rights import Principal
from master.access.users import Standing, Users, check_robot_login, digest
from master.storage import tables as db
from master.storage.store import Store
from rce.api.roles import UserRole
from rce.errors import (
    AlreadyExists,
    Forbidden,
    InvalidName,
    InvalidRequest,
    NotFound,
    RceError,
    TooManyAttempts,
    Unauthorized,
)


async def contents(store: Store) -> str:
    """Return the whole contents of the database as text."""

    def read(connection: sa.Connection) -> list[Any]:
        return [row for table in db.tables.sorted_tables for row in connection.execute(sa.select(table))]

    return repr(await store.run(read))


@pytest.mark.parametrize("secret", [digest("secret"), digest("secret").upper()])
async def test_sha256_of_the_password_authenticates(users: Users, secret: str) -> None:
    assert await users.check("ann", secret) == Principal("ann", "user")


async def test_verified_password_is_accepted_again_until_it_changes(
    users: Users, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = digest("secret")
    await users.check("ann", old)

    async def never(hashed: str | None, secret: str) -> bool:
        raise AssertionError("hashed again")

    with monkeypatch.context() as patch:
        patch.setattr(users.passwords, "verify", never)
        assert await users.check("ann", old) == Principal("ann", "user")
    await users.change_password("ann", "another secret")
    with pytest.raises(Unauthorized):
        await users.check("ann", old)


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


async def test_database_contains_no_secrets(users: Users, store: Store) -> None:
    processes = JoinTokens(store)
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
    removed = await users.removals()
    assert removed.keys() == {"ann"}
    assert await contents(store) == str(list(removed.items())), "nothing else is left"


# --- roles ------------------------------------------------------------------------------------------------------------


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


async def test_wrong_passwords_delay_passwords_but_not_keys(users: Users) -> None:
    key, _ = await users.keys.add("ann")
    for name in ("ann", "nobody"):
        said = []
        for secret in (*["wrong"] * 6, "secret"):
            with pytest.raises((Unauthorized, TooManyAttempts)) as raised:
                await users.check(name, digest(secret), "10.0.0.1")
            said.append(type(raised.value))
        assert said == [Unauthorized] * 5 + [TooManyAttempts] * 2
    assert (await users.check("ann", key, "10.0.0.1")).user == "ann"


@pytest.mark.parametrize(
    ("principal", "holds"),
    [
        (Principal("ann", "user"), True),
        (Principal("ann", "viewer"), False),  # by password one has one's present role
        (Principal("ann", "operator"), False),
        (Principal("bob", "user"), False),
        (Principal("ann", "robot", "k1"), True),
        (Principal("ann", "robot", "k2"), False),
        (Principal("ann", "operator", "k1"), False),
        (Principal("ann", "robot", lent=True), True),
        (Principal("ann", "robot", "k1", lent=True), True),
        (Principal("ann", "robot", "k2", lent=True), False),
    ],
)
def test_credentials_hold_while_their_user_role_and_key_do(principal: Principal, holds: bool) -> None:
    assert Standing({"ann": "user"}, {"k1"}).holds(principal) == holds


async def test_standing_has_the_keys_that_have_not_expired(users: Users) -> None:
    _, endless = await users.keys.add("ann")
    _, present = await users.keys.add("ann", expires=time.time() + 100)
    await users.keys.add("ann", expires=time.time() - 1)
    assert await users.standing() == Standing({"ann": "user"}, {endless.id, present.id})


async def test_unknown_user_cannot_be_changed(users: Users) -> None:
    for action in (
        users.get("bob"),
        users.remove("bob"),
        users.change_role("bob", "viewer"),
        users.change_password("bob", "x"),
    ):
        with pytest.raises(NotFound, match="no user bob"):
            await action
