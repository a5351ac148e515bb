"""Fixtures: databases, a Master with processes, the entry over HTTP."""

from __future__ import annotations

import os
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import sqlalchemy as sa
from twisted.internet.base import ReactorBase

from master.access.users import Users
from master.execution import lifecycle
from master.storage.store import Store
from tests.support.master.database import open_store
from tests.support.master.entry import Ask, asking
from tests.support.master.fleet import Fleet
from tests.support.master.peers import LONG, Furnished, Platform
from tests.support.master.postgresql import POSTGRES, needs_postgres
from tests.support.master.served import serve_entry


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=needs_postgres)])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """URL of an empty database. In PostgreSQL each process of a test run has its own schema."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'master.db'}"
    schema = os.environ.get("PYTEST_XDIST_WORKER", "alone")
    engine = sa.create_engine(POSTGRES)
    with engine.begin() as connection:
        connection.execute(sa.text(f"DROP SCHEMA IF EXISTS {schema} CASCADE"))
        connection.execute(sa.text(f"CREATE SCHEMA {schema}"))
    engine.dispose()
    return sa.make_url(POSTGRES).update_query_dict({"options": f"-csearch_path={schema}"}).render_as_string(False)


@pytest.fixture
async def port(reactor: ReactorBase, fleet: Fleet, tmp_path: Path) -> AsyncIterator[int]:
    """Port of the entry and the dashboard of the platform `fleet`, a fixture of the test's module."""
    async with serve_entry(fleet.state, tmp_path) as port:
        yield port


@pytest.fixture
def ask(port: int) -> Ask:
    return asking(port)


@pytest.fixture
async def store(tmp_path: Path) -> AsyncIterator[Store]:
    store = await open_store(f"sqlite:///{tmp_path / 'master.db'}")
    yield store
    await store.close()


@pytest.fixture
async def users(store: Store) -> Users:
    users = Users(store)
    await users.add("ann", "secret")
    return users


@pytest.fixture
async def platform(reactor: ReactorBase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Platform]:
    monkeypatch.setattr(lifecycle, "RETRY_FIRST", 0.0)
    platform = Platform(reactor, f"sqlite:///{tmp_path / 'master.db'}", LONG)
    await platform.start()
    await platform.master.users.add("ann", "secret")
    await platform.master.users.add("bob", "secret")
    yield platform
    await platform.stop()


@pytest.fixture
async def furnished(platform: Platform) -> Furnished:
    return await Furnished(platform).build()
