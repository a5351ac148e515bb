"""Connections to PostgreSQL that are lost: what runs again, and what its caller must look at."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

import pytest
import sqlalchemy as sa

from master.storage import postgresql
from master.storage.store import Store, UnknownOutcome
from tests.support.master.postgresql import needs_postgres

pytestmark = [needs_postgres, pytest.mark.parametrize("url", ["postgresql"], indirect=True)]
TERMINATE = sa.text("SELECT pg_terminate_backend(:pid)")


@pytest.fixture
async def store(url: str) -> AsyncIterator[Store]:
    store = Store(url)
    await store.open()
    yield store
    await store.close()


class Terminator:
    """Work whose connection is terminated at its first run."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.runs = 0

    def __call__(self, connection: sa.Connection) -> int:
        self.runs += 1
        if self.runs == 1:
            terminate(self.url, connection)
        return int(connection.execute(sa.text("SELECT 1")).scalar_one())


def terminate(url: str, connection: sa.Connection) -> None:
    pid = connection.execute(sa.text("SELECT pg_backend_pid()")).scalar_one()
    engine = sa.create_engine(url)
    with engine.begin() as other:
        other.execute(TERMINATE, {"pid": pid})
    engine.dispose()


async def test_transaction_runs_again_over_a_new_connection(store: Store, url: str) -> None:
    work = Terminator(url)
    assert await store.run(work) == 1
    assert work.runs == 2


async def test_work_that_was_lost_in_its_commit_has_an_unknown_outcome(store: Store, url: str) -> None:
    runs: list[Any] = []

    def work(connection: sa.Connection) -> None:
        runs.append(connection)
        if len(runs) == 1:
            terminate(url, connection)

    with pytest.raises(UnknownOutcome, match="look at what is there"):
        await store.run(work)
    runs.clear()
    await store.run(work, repeatable=True)
    assert len(runs) == 2


async def test_session_ends_idle_transactions(url: str) -> None:
    engine = postgresql.connect(sa.make_url(url), 3)
    with engine.connect() as connection:
        assert connection.execute(sa.text("SHOW idle_in_transaction_session_timeout")).scalar() == "4s"
    engine.dispose()


def test_other_errors_are_no_losses(url: str) -> None:
    engine = sa.create_engine(url)
    with engine.connect() as connection, pytest.raises(sa.exc.ProgrammingError) as raised:
        connection.execute(sa.text("SELECT nonsense"))
    assert not postgresql.is_lost(raised.value)
    engine.dispose()
