"""Tables beside the records, in every kind of database: users, keys, limits, grants, audit log."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator

import pytest

from master.access.audit import Audit, AuditFilter, Origin
from master.access.grants import Grants
from master.access.join_tokens import JoinTokens
from master.access.user_limits import UserLimits
from master.access.users import Users, digest
from master.graph.limits import Policy
from master.storage.store import Store
from rce.api.roles import Principal, Scopes
from rce.errors import InvalidRequest, NotFound, RceError, Unauthorized


@pytest.fixture
async def store(url: str) -> AsyncIterator[Store]:
    store = Store(url)
    await store.open()
    await Users(store).add("ann", "secret")
    yield store
    await store.close()


async def test_users_and_keys_in_every_database(store: Store) -> None:
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


async def test_limits_grants_and_credentials_in_every_database(store: Store) -> None:
    limits = UserLimits(store, Policy(size=2))
    await limits.open()
    await limits.change("ann", {"memory": 2**40})
    again = UserLimits(store)
    await again.open()
    assert again.of("ann") == Policy(size=2, memory=2**40)
    grants, users = Grants(store), Users(store)
    _, key = await users.keys.add("ann")
    grant = await grants.give("maps", "ann", key.id)
    lent = await grants.issue_key("maps", grant, 60)
    assert (await grants.check("ann", lent.key)).user == "ann"
    await users.keys.revoke("ann", key.id)
    with pytest.raises(RceError):
        await grants.issue_key("maps", grant, 60)
    processes = JoinTokens(store)
    await processes.allow("west", "robot", "token")
    credential = await processes.admit("west", "robot", "token")
    await processes.admit("west", "robot", credential)
    assert await processes.names() == ["west"]


async def test_audit_log_in_every_database(store: Store) -> None:
    audit, origin = Audit(store), Origin("http", "127.0.0.1")
    ann = Principal("ann", "user", "k1")
    for number in range(5):
        audit.note(ann, "CreateContainer", "ann", f"ann/e{number % 2}/n{number}", origin)
    audit.note(None, "login", "bob", "ü_%", origin, Unauthorized("no"))
    assert [each.object for each in await audit.find(AuditFilter(object="ann/e0"), None, 9)] == [
        "ann/e0/n4",
        "ann/e0/n2",
        "ann/e0/n0",
    ]
    newest, *_ = await audit.find(AuditFilter(), None, 9)
    assert (newest.user, newest.object, newest.result) == ("", "ü_%", "unauthorized")
    assert newest.address == "127.0.0.1"
    page = await audit.find(AuditFilter(concerning="ann", result="ok"), newest.id, 2)
    assert [each.object for each in page] == ["ann/e0/n4", "ann/e1/n3"]
    assert page[0].key == "k1"
    assert await audit.find(AuditFilter(object="_"), None, 9) == []
    now = time.time()
    assert len(await audit.find(AuditFilter(since=now - 60, until=now + 1), None, 9)) == 6
    await audit.forget(1)
    assert len(await audit.find(AuditFilter(), None, 9)) == 6
    await audit.forget(-1e-9)
    assert await audit.find(AuditFilter(), None, 9) == []


async def test_text_that_a_database_cannot_store_is_refused(store: Store) -> None:
    """PostgreSQL cannot store NUL: such names are refused, and audit entries about them are not lost."""
    audit, users = Audit(store), Users(store)
    audit.note(Principal("ann", "user"), "login", "an\0n", "ann/\0", Origin("http"))
    (entry,) = await audit.find(AuditFilter(concerning="an\ufffdn"), None, 9)
    assert entry.object == "ann/\ufffd"
    with pytest.raises((InvalidRequest, Unauthorized)):
        await users.check("ann\0", digest("secret"))
    with pytest.raises((InvalidRequest, NotFound)):
        await users.keys.get("ann", "\0")
    with pytest.raises((InvalidRequest, NotFound)):
        await users.remove("ann\0")
