"""A database of an earlier version is brought up to date when it is opened."""

from __future__ import annotations

import pytest
import sqlalchemy as sa

from master import store as db
from master.migration import bring_up_to_date
from master.store import Store
from master.users import Users
from rce.errors import InvalidRequest


def execute(url: str, *statements: str) -> None:
    engine = sa.create_engine(url)
    with engine.begin() as connection:
        for statement in statements:
            connection.execute(sa.text(statement))
    engine.dispose()


async def test_columns_and_tables_that_are_new(url: str) -> None:
    """Keys had no end once, and nobody had limits."""
    store = Store(url)
    await store.open()
    await Users(store).add("ann", "secret")
    secret, _ = await Users(store).keys.add("ann")
    await store.close()
    execute(url, "ALTER TABLE api_keys DROP COLUMN expires", "DROP TABLE limits")
    store = Store(url)
    await store.open()
    assert (await Users(store).check("ann", secret)).user == "ann"
    (key,) = await Users(store).keys.of("ann")
    assert key.expires is None
    await store.close()


def test_nothing_is_added_twice(url: str) -> None:
    engine = sa.create_engine(url)
    db.tables.create_all(engine)
    with engine.begin() as connection:
        for name in ("expires", "used", "scopes"):
            connection.execute(sa.text(f"ALTER TABLE api_keys DROP COLUMN {name}"))
    assert bring_up_to_date(engine, db.tables) == ["api_keys.expires", "api_keys.used", "api_keys.scopes"]
    assert bring_up_to_date(engine, db.tables) == []
    engine.dispose()


def test_text_that_may_be_longer_now(url: str) -> None:
    engine = sa.create_engine(url)
    db.tables.create_all(engine)
    if engine.dialect.name == "sqlite":
        assert bring_up_to_date(engine, db.tables) == []
    else:
        with engine.begin() as connection:
            connection.execute(sa.text("ALTER TABLE records ALTER COLUMN key TYPE VARCHAR(1100)"))
            connection.execute(sa.text("ALTER TABLE limits ALTER COLUMN value TYPE VARCHAR(10)"))
        assert bring_up_to_date(engine, db.tables) == ["limits.value", "records.key"]
        assert bring_up_to_date(engine, db.tables) == []
    engine.dispose()


async def test_a_database_that_is_too_different(url: str) -> None:
    execute(url, "CREATE TABLE users (name TEXT PRIMARY KEY)")
    store = Store(url)
    with pytest.raises(InvalidRequest, match=r"no column users\.password"):
        await store.open()
    await store.close()
