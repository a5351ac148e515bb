"""What the Master keeps beside its records, in every kind of database: users, keys, limits, grants, the audit log."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator

import pytest

from master.audit import Audit, Origin, Wanted
from master.grants import Grants
from master.limits import Limits
from master.policies import Policy
from master.processes import Processes
from master.store import Store
from master.users import Users, digest
from rce.errors import InvalidRequest, NotFound, RceError, Unauthorized
from rce.roles import Principal, Scopes


@pytest.fixture
async def store(url: str) -> AsyncIterator[Store]:
    store = Store(url)
    await store.open()
    await Users(store).add("ann", "secret")
    yield store
    await store.close()


async def test_users_and_keys(store: Store) -> None:
    users = Users(store)
    scopes = Scopes(robot="r1", environments=["brain"])
    secret, key = await users.keys.add("ann", "robot", "für den Roboter", time.time() + 60, scopes)
    assert (await users.check("", secret)).scopes == scopes
    await users.keys.note_use()
    (kept,) = await Users(store).keys.of("ann")
    assert (kept.id, kept.label, kept.expires, kept.scopes) == (key.id, key.label, key.expires, scopes)
    assert kept.used is not None
    other, _ = await users.keys.rotate("ann", key.id)
    with pytest.raises(Unauthorized):
        await users.check("ann", secret)
    assert (await users.check("ann", digest("secret"))).user == "ann"
    await users.remove("ann")
    with pytest.raises(Unauthorized):
        await users.check("ann", other)


async def test_limits_grants_and_credentials(store: Store) -> None:
    limits = Limits(store, Policy(size=2))
    await limits.open()
    await limits.change("ann", {"memory": 2**40})
    again = Limits(store)
    await again.open()
    assert again.of("ann") == Policy(size=2, memory=2**40)
    grants, users = Grants(store), Users(store)
    _, key = await users.keys.add("ann")
    grant = await grants.give("maps", "ann", key.id)
    lent = await grants.borrow("maps", grant, 60)
    assert (await grants.check("ann", lent.key)).user == "ann"
    await users.keys.revoke("ann", key.id)
    with pytest.raises(RceError):
        await grants.borrow("maps", grant, 60)
    processes = Processes(store)
    await processes.allow("west", "robot", "token")
    credential = await processes.admit("west", "robot", "token")
    await processes.admit("west", "robot", credential)
    assert await processes.names() == ["west"]


async def test_the_audit_log(store: Store) -> None:
    audit, origin = Audit(store), Origin("http", "127.0.0.1")
    ann = Principal("ann", "user", "k1")
    for number in range(5):
        audit.note(ann, "CreateContainer", "ann", f"ann/e{number % 2}/n{number}", origin)
    audit.note(None, "login", "bob", "ü_%", origin, Unauthorized("no"))
    assert [each.object for each in await audit.find(Wanted(object="ann/e0"), None, 9)] == [
        "ann/e0/n4",
        "ann/e0/n2",
        "ann/e0/n0",
    ]
    newest, *_ = await audit.find(Wanted(), None, 9)
    assert (newest.user, newest.object, newest.result) == ("", "ü_%", "unauthorized")
    assert newest.address == "127.0.0.1"
    page = await audit.find(Wanted(concerning="ann", result="ok"), newest.id, 2)
    assert [each.object for each in page] == ["ann/e0/n4", "ann/e1/n3"]
    assert page[0].key == "k1"
    assert await audit.find(Wanted(object="_"), None, 9) == []
    now = time.time()
    assert len(await audit.find(Wanted(since=now - 60, until=now + 1), None, 9)) == 6
    await audit.forget(1)
    assert len(await audit.find(Wanted(), None, 9)) == 6
    await audit.forget(-1e-9)
    assert await audit.find(Wanted(), None, 9) == []


async def test_a_character_that_a_database_cannot_hold(store: Store) -> None:
    """PostgreSQL has no text with NUL. What names such a thing is of nobody; what is noted of it must not be lost."""
    audit, users = Audit(store), Users(store)
    audit.note(Principal("ann", "user"), "login", "an\0n", "ann/\0", Origin("http"))
    (entry,) = await audit.find(Wanted(concerning="an\ufffdn"), None, 9)
    assert entry.object == "ann/\ufffd"
    with pytest.raises((InvalidRequest, Unauthorized)):
        await users.check("ann\0", digest("secret"))
    with pytest.raises((InvalidRequest, NotFound)):
        await users.keys.get("ann", "\0")
    with pytest.raises((InvalidRequest, NotFound)):
        await users.remove("ann\0")
