"""The row of the leader in PostgreSQL: terms, renewals, and transactions that a take-over waits for."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest
import sqlalchemy as sa

from master.graph.records import Environment, EnvironmentOptions
from master.graph.state import State
from master.storage import postgresql
from master.storage import tables as db
from master.storage.leader_row import LeaderRow, create, fence
from master.storage.lease import Lease
from master.storage.store import Store
from rce.errors import Unavailable
from tests.support.master.postgresql import needs_postgres

pytestmark = [needs_postgres, pytest.mark.parametrize("url", ["postgresql"], indirect=True)]
PATIENCE = 20.0  # seconds until a test that hangs fails


@pytest.fixture
async def store(url: str) -> AsyncIterator[Store]:
    store = Store(url)
    await store.prepare(create)
    await store.open()
    yield store
    await store.close()


@pytest.fixture
async def rows(store: Store) -> AsyncIterator[tuple[LeaderRow, LeaderRow]]:
    first, second = LeaderRow(store.url, "1"), LeaderRow(store.url, "2")
    yield first, second
    first.close()
    second.close()


async def expire(store: Store) -> None:
    await store.run(lambda connection: connection.execute(db.leader.update().values(until=sa.func.now())))


async def test_row_has_one_holder(store: Store, rows: tuple[LeaderRow, LeaderRow]) -> None:
    first, second = rows
    term, url = await first.take("http://first/", 10)
    assert term > 1_700_000_000
    assert url == "http://first/"
    assert await second.take("http://second/", 10) == (0, "http://first/")
    assert await first.renew(term, 10)
    assert not await second.renew(term - 1, 10)


async def test_expired_row_is_taken_with_a_later_term(store: Store, rows: tuple[LeaderRow, LeaderRow]) -> None:
    first, second = rows
    term, _ = await first.take("http://first/", 10)
    await expire(store)
    later, url = await second.take("http://second/", 10)
    assert later > term
    assert url == "http://second/"
    assert not await first.renew(term, 10)


async def test_row_that_is_not_renewed_is_taken_though_the_clock_of_the_database_has_jumped_back(store: Store) -> None:
    now = 0.0
    first, second = LeaderRow(store.url, "1"), LeaderRow(store.url, "2", lambda: now)
    try:
        term, _ = await first.take("http://first/", 3600)
        assert await second.take("http://second/", 10) == (0, "http://first/")
        now = 9.9
        assert await second.take("http://second/", 10) == (0, "http://first/")
        assert await first.renew(term, 3600)
        now = 10.1
        assert await second.take("http://second/", 10) == (0, "http://first/"), "it was renewed meanwhile"
        now = 20.0
        assert await second.take("http://second/", 10) == (0, "http://first/")
        now = 20.2
        later, url = await second.take("http://second/", 10)
        assert (later > term, url) == (True, "http://second/")
        assert not await first.renew(term, 10)
    finally:
        first.close()
        second.close()


async def test_restarted_holder_does_not_wait(store: Store, rows: tuple[LeaderRow, LeaderRow]) -> None:
    first, _ = rows
    term, _ = await first.take("http://first/", 10)
    again, _ = await first.take("http://first/", 10)
    assert again > term


async def test_released_row_is_free(store: Store, rows: tuple[LeaderRow, LeaderRow]) -> None:
    first, second = rows
    term, _ = await first.take("http://first/", 10)
    await first.release(term)
    assert (await second.take("http://second/", 10))[0] > term


async def test_nothing_is_stored_with_an_old_term(store: Store, rows: tuple[LeaderRow, LeaderRow]) -> None:
    first, second = rows
    lease = Lease(first)
    await lease.take("http://first/")
    store.fence = fence(lease)
    state = State()
    state.environments.put(Environment("ann/kept", EnvironmentOptions(), "r", "m"))
    await store.save(state)
    store.fence = None
    await expire(store)
    store.fence = fence(lease)
    await second.take("http://second/", 10)
    state.environments.put(Environment("ann/refused", EnvironmentOptions(), "r", "m"))
    with pytest.raises(Unavailable, match="is a standby"):
        await store.save(state)
    assert await asyncio.wait_for(lease.lost, PATIENCE) == "another Master leads"
    store.fence, store._waiting = None, {}
    found = await store.run(lambda connection: list(connection.scalars(sa.select(db.records.c.key))))
    assert found == ["ann/kept"]
    await lease.release()


async def test_take_over_waits_for_a_transaction_and_a_renewal_does_not(
    store: Store, rows: tuple[LeaderRow, LeaderRow]
) -> None:
    first, second = rows
    lease = Lease(first)
    await lease.take("http://first/")
    await expire(store)
    check = fence(lease)
    engine = postgresql.connect(store.url, 5)
    with engine.begin() as connection:
        check(connection)
        assert await asyncio.wait_for(first.renew(lease.term, 0), PATIENCE)
        taking = asyncio.create_task(second.take("http://second/", 10))
        await asyncio.wait([taking], timeout=0.3)
        assert not taking.done()
    assert (await asyncio.wait_for(taking, PATIENCE))[0] > lease.term
    engine.dispose()
    await lease.release()


async def test_transaction_of_a_stopped_master_does_not_stop_a_take_over(
    store: Store, rows: tuple[LeaderRow, LeaderRow], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(postgresql, "IDLE", 200)
    first, second = rows
    lease = Lease(first)
    await lease.take("http://first/")
    await expire(store)
    engine = postgresql.connect(store.url, 5)
    connection = engine.connect()
    connection.begin()
    fence(lease)(connection)
    assert (await asyncio.wait_for(second.take("http://second/", 10), PATIENCE))[0] > lease.term
    with pytest.raises(sa.exc.DBAPIError) as raised:
        connection.execute(sa.select(db.leader))
    assert postgresql.is_lost(raised.value)
    connection.close()
    engine.dispose()
    await lease.release()


async def test_unreachable_database_is_unavailable(url: str) -> None:
    row = LeaderRow(sa.make_url("postgresql+psycopg://rce@127.0.0.1:1/none"), "1")
    with pytest.raises(Unavailable, match="does not answer"):
        await row.take("http://first/", 10)
    row.close()
