"""Contents of the database as text."""

from __future__ import annotations

from pathlib import Path

import pytest
import sqlalchemy as sa

from master.access.audit import Audit, AuditFilter, Origin
from master.access.users import Users, digest
from master.storage import dump
from master.storage.migration import HEAD
from master.storage.store import Store
from master.storage.tables import tables
from rce.api.roles import Principal, Scopes
from rce.errors import AlreadyExists, InvalidRequest


async def rows(store: Store) -> dict[str, list[tuple[object, ...]]]:
    """Return the contents of all tables."""

    def read(connection: sa.Connection) -> dict[str, list[tuple[object, ...]]]:
        return {
            name: sorted((tuple(row) for row in connection.execute(sa.select(table))), key=repr)
            for name, table in tables.tables.items()
        }

    return await store.run(read)


async def fill(store: Store) -> None:
    users = Users(store)
    await users.add("ann", "correct horse")
    _, key = await users.keys.add("ann", "user", "ü")
    await users.keys.add("ann", label="child", scopes=Scopes(robot="r1"), parent=key.id)
    audit = Audit(store)
    for action in ("key.create", "key.revoke"):
        with audit.auditing(action, "ann", "thing", Origin("offline")) as audited:
            audited.who = Principal("ann", "user")
    await audit.flush()


async def test_database_is_the_same_after_write_and_read(url: str, tmp_path: Path) -> None:
    directory = tmp_path / "dump"
    directory.mkdir()
    source = Store(f"sqlite:///{tmp_path / 'source.db'}")
    await source.open()
    await fill(source)
    revision = await source.run(lambda connection: dump.write(connection, directory))
    assert revision == HEAD
    target = Store(url)
    await target.run(lambda connection: dump.read(connection, directory, revision, replace=True))
    await target.open()
    assert await rows(target) == await rows(source)
    assert await Users(target).check("ann", digest("correct horse")) == Principal("ann", "user")
    await fill_audit(target)  # new rows are numbered after the restored ones
    await source.close()
    await target.close()


async def fill_audit(store: Store) -> None:
    audit = Audit(store)
    before = len(await audit.find(AuditFilter(), None, 100))
    with audit.auditing("key.create", "ann", "thing", Origin("offline")) as audited:
        audited.who = Principal("ann", "user")
    await audit.flush()
    assert len(await audit.find(AuditFilter(), None, 100)) == before + 1


async def test_users_are_not_replaced_without_asking(store: Store, users: Users, tmp_path: Path) -> None:
    revision = await store.run(lambda connection: dump.write(connection, tmp_path))
    before = await rows(store)
    with pytest.raises(AlreadyExists, match="--replace"):
        await store.run(lambda connection: dump.read(connection, tmp_path, revision, replace=False))
    assert await rows(store) == before


async def test_failed_read_changes_nothing(store: Store, users: Users, tmp_path: Path) -> None:
    revision = await store.run(lambda connection: dump.write(connection, tmp_path))
    before = await rows(store)
    (tmp_path / f"users{dump.SUFFIX}").write_text('{"name": "bob"}\n')
    with pytest.raises(sa.exc.IntegrityError):
        await store.run(lambda connection: dump.read(connection, tmp_path, revision, replace=True))
    assert await rows(store) == before


async def test_files_of_a_later_version_are_refused(store: Store, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="later version"):
        await store.run(lambda connection: dump.read(connection, tmp_path, "9999", replace=False))


async def test_other_database_is_refused(tmp_path: Path) -> None:
    store = Store(f"sqlite:///{tmp_path / 'other.db'}")
    with pytest.raises(InvalidRequest, match="not the database of a Master"):
        await store.run(lambda connection: dump.write(connection, tmp_path))
    await store.close()
