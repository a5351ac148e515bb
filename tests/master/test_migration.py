"""A database of an earlier version is brought up to date when it is opened."""

from __future__ import annotations

from pathlib import Path

import pytest
import sqlalchemy as sa

from master import store as db
from master.migration import bring_up_to_date
from master.store import Store
from master.users import Users
from rce.errors import InvalidRequest


def execute(path: Path, *statements: str) -> None:
    engine = sa.create_engine(f"sqlite:///{path}")
    with engine.begin() as connection:
        for statement in statements:
            connection.execute(sa.text(statement))
    engine.dispose()


async def test_columns_and_tables_that_are_new(tmp_path: Path) -> None:
    """Keys had no end once, and nobody had limits."""
    url = f"sqlite:///{tmp_path / 'master.db'}"
    store = Store(url)
    await store.open()
    await Users(store).add("ann", "secret")
    secret, _ = await Users(store).add_key("ann")
    await store.close()
    execute(tmp_path / "master.db", "ALTER TABLE api_keys DROP COLUMN expires", "DROP TABLE limits")
    store = Store(url)
    await store.open()
    assert (await Users(store).check("ann", secret)).user == "ann"
    (key,) = await Users(store).keys.of("ann")
    assert key.expires is None
    await store.close()


def test_nothing_is_added_twice(tmp_path: Path) -> None:
    engine = sa.create_engine(f"sqlite:///{tmp_path / 'master.db'}")
    db.tables.create_all(engine)
    with engine.begin() as connection:
        connection.execute(sa.text("ALTER TABLE api_keys DROP COLUMN expires"))
    assert bring_up_to_date(engine, db.tables) == ["api_keys.expires"]
    assert bring_up_to_date(engine, db.tables) == []
    engine.dispose()


async def test_a_database_that_is_too_different(tmp_path: Path) -> None:
    execute(tmp_path / "master.db", "CREATE TABLE users (name TEXT PRIMARY KEY)")
    store = Store(f"sqlite:///{tmp_path / 'master.db'}")
    with pytest.raises(InvalidRequest, match=r"no column users\.password"):
        await store.open()
    await store.close()
