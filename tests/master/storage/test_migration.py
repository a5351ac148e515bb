"""Databases of earlier versions are migrated when they are opened."""

from __future__ import annotations

import json
from importlib import import_module
from typing import Any

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

from master.access.user_limits import UserLimits
from master.access.users import Users
from master.graph.limits import Policy
from master.graph.records import EnvironmentOptions, Qos
from master.graph.state import State
from master.storage import tables as db
from master.storage.migration import HEAD, SCRIPTS, migrate, upgrade
from master.storage.store import Store
from rce.errors import InvalidRequest

SPEC = {"id": "1" * 32, "owner": "ann/brain", "tag": "in", "kind": "PublisherInterface", "type": "std_msgs/String"}
OLD_RECORDS = {
    ("Node", "ann/brain/n"): {"owner": "ann/brain", "spec": {"tag": "n", "pkg": "p", "exe": "e", "args": "--x 'ü'"}},
    ("Parameter", "ann/brain/:rate"): {"owner": "ann/brain", "spec": {"name": "rate", "value": 2**63 - 1, "node": ""}},
    ("Interface", "ann/brain/in"): {"spec": {**SPEC, "addr": "chat", "qos": {"depth": 5}, "format": "jpeg"}},
    ("Environment", "ann/brain"): {
        "name": "ann/brain",
        "options": {"size": 2, "specialFeatures": ["camera"], "env": {"A": "1"}, "group": "g", "groupIP": "10.0.0.7"},
        "run": "2" * 32,
        "machine": "m1",
    },
}


def execute(url: str, *statements: str) -> None:
    engine = sa.create_engine(url)
    with engine.begin() as connection:
        for statement in statements:
            connection.execute(sa.text(statement))
    engine.dispose()


def make_tables(url: str) -> sa.Engine:
    """Make the tables of a version from before Alembic."""
    engine = sa.create_engine(url)
    db.tables.create_all(engine)
    return engine


def test_head_is_the_newest_revision() -> None:
    config = Config()
    config.set_main_option("script_location", str(SCRIPTS))
    assert ScriptDirectory.from_config(config).get_heads() == [HEAD]


def test_revisions_make_the_tables_of_this_version(url: str) -> None:
    engine = sa.create_engine(url)
    upgrade(engine)
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"include_object": _is_compared})
        assert compare_metadata(context, db.tables) == []
    engine.dispose()


def _is_compared(item: Any, name: str | None, kind: str, reflected: bool, other: object) -> bool:
    """Leave out the references of columns that a revision added: SQLAlchemy reads them incompletely from SQLite."""
    added = {("api_keys", "parent"), ("tokens", "key")}
    return kind != "foreign_key_constraint" or added.isdisjoint((item.table.name, each.name) for each in item.columns)


async def test_missing_columns_and_tables_are_added(url: str) -> None:
    make_tables(url).dispose()
    execute(url, "ALTER TABLE api_keys DROP COLUMN expires", "DROP TABLE limits")
    store = Store(url)
    await store.open()
    await Users(store).add("ann", "secret")
    secret, _ = await Users(store).keys.add("ann")
    assert (await Users(store).check("ann", secret)).user == "ann"
    (key,) = await Users(store).keys.of("ann")
    assert key.expires is None
    await store.close()


def test_shorter_text_columns_are_widened(url: str) -> None:
    engine = make_tables(url)
    if engine.dialect.name != "sqlite":  # which does not bound text
        with engine.begin() as connection:
            connection.execute(sa.text("ALTER TABLE records ALTER COLUMN key TYPE VARCHAR(1100)"))
    upgrade(engine)
    with engine.begin() as connection:
        connection.execute(db.records.insert(), {"kind": "Robot", "key": "k" * 1600, "value": "{}"})
    engine.dispose()


async def test_key_of_an_earlier_version_takes_along_what_is_made_with_it(url: str) -> None:
    engine = sa.create_engine(url)
    import_module("master.storage.migrations.versions.0001_tables").tables.create_all(engine)
    engine.dispose()
    execute(
        url,
        "INSERT INTO users (name, password, role, created) VALUES ('ann', '', 'user', 0)",
        """INSERT INTO api_keys (digest, id, "user", role, label, created) VALUES ('d', 'old', 'ann', 'user', '', 0)""",
    )
    store = Store(url)
    await store.open()
    keys = Users(store).keys
    await keys.add("ann", parent="old")
    await store.run(lambda connection: connection.execute(sa.text("DELETE FROM api_keys WHERE id = 'old'")))
    assert await keys.all() == []
    await store.close()


async def test_records_of_version_0_1_are_rewritten(url: str) -> None:
    engine = make_tables(url)
    with engine.begin() as connection:
        rows = [{"kind": kind, "key": key, "value": json.dumps(old)} for (kind, key), old in OLD_RECORDS.items()]
        connection.execute(db.records.insert(), rows)
    engine.dispose()
    state, store = State(), Store(url)
    await store.open()
    await store.load(state)
    await store.close()
    node, interface = state.nodes["ann/brain/n"], state.interfaces["ann/brain/in"]
    assert (node.package, node.executable, node.arguments) == ("p", "e", "--x 'ü'")
    assert state.parameters["ann/brain/:rate"].value == 2**63 - 1
    assert (interface.id, interface.address, interface.format) == ("1" * 32, "chat", "jpeg")
    assert interface.qos == Qos(depth=5)
    options = EnvironmentOptions(size=2, features=["camera"], variables={"A": "1"}, group="g", group_address="10.0.0.7")
    assert state.environments["ann/brain"].options == options


async def test_limits_of_zero_of_an_earlier_version_stay_no_limit(url: str) -> None:
    engine = sa.create_engine(url)
    with engine.begin() as connection:
        migrate(connection, "0004")
        connection.execute(db.limits.insert(), {"user": "ann", "value": '{"robots": 0, "size": 2, "images": []}'})
    engine.dispose()
    store = Store(url)
    await store.open()
    limits = UserLimits(store, Policy(robots=5))
    await limits.open()
    await store.close()
    assert limits.of("ann") == Policy(size=2)


def test_migration_runs_once(url: str) -> None:
    engine = sa.create_engine(url)
    upgrade(engine)
    upgrade(engine)
    with engine.connect() as connection:
        assert connection.execute(sa.text("SELECT version_num FROM alembic_version")).all() == [(HEAD,)]
    engine.dispose()


async def test_foreign_database_is_refused(url: str) -> None:
    execute(url, "CREATE TABLE users (name TEXT PRIMARY KEY)")
    store = Store(url)
    with pytest.raises(InvalidRequest, match=r"no column users\.password"):
        await store.open()
    await store.close()


async def test_database_of_a_later_version_is_refused(url: str) -> None:
    engine = sa.create_engine(url)
    upgrade(engine)
    engine.dispose()
    execute(url, "UPDATE alembic_version SET version_num = '9999'")
    store = Store(url)
    with pytest.raises(InvalidRequest, match="later version of RCE"):
        await store.open()
    await store.close()
