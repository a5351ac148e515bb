"""Store: every kind of record, batched writes, failures of the database."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from master.graph import catalogue, packages, secrets
from master.graph.records import Connection, Environment, EnvironmentOptions, NodeEnd, Parameter, Version, Waiting
from master.graph.state import State
from master.storage import store as store_module
from master.storage import tables as db
from master.storage.store import Store
from rce.errors import DiskFull, InvalidRequest
from rce.protocol import messages as m
from tests.support.master.fleet import everything, wired
from tests.support.master.offers import declared


@pytest.fixture
async def store(url: str) -> AsyncIterator[Store]:
    store = Store(url)
    await store.open()
    yield store
    await store.close()


async def loaded(url: str) -> State:
    """Load the state as a Master does at its start."""
    state = State()
    store = Store(url)
    await store.open()
    await store.load(state)
    await store.close()
    return state


def full() -> State:
    fleet = wired()
    fleet.do("ann", m.AddNode("brain", "n", "p", "e", "--x 'ü'", "name", "space"))
    values: dict[str, m.ParameterValue] = {
        "b": True,
        "i": 2**63 - 1,
        "f": 0.1,
        "s": "ä\x00\n",
        "l": [1, "two", 3.5, False],
    }
    for name, value in values.items():
        fleet.do("ann", m.SetParameter("brain", name, value))
    options = m.ContainerData(size=2, group="g", groupIP="192.168.1.7", restart="no")
    fleet.do("bob", m.CreateContainer("other", options))
    packages.add(fleet.state, "ann", "own", Version("0" * 64, 7, ["p", "q"], 1.5))
    packages.share(fleet.state, "ann", "own", ["bob"])
    fleet.state.ends.put(NodeEnd(fleet.state.nodes["ann/brain/n"], -9, ["last words"], 1.5))
    fleet.state.waiting.put(Waiting("ann/r1/x", "ann/r2/x", "ann/r1"))
    fleet.do("ann", m.AddRecorder("brain", "box"))
    secrets.put(fleet.state, "ann", "database", "sealed", 1.5)
    catalogue.publish(fleet.state, "ann", declared(), fleet.ids)
    fleet.do("bob", m.UseService("ann/parrot"), robot="r1")
    return fleet.state


async def test_every_kind_of_record_is_stored_and_loaded(store: Store, url: str) -> None:
    state = full()
    assert all(len(table) for table in state.tables())
    await store.save(state)
    back = await loaded(url)
    assert everything(back) == everything(state)
    assert not any(table.changed for table in (*back.tables(), *state.tables()))
    assert back.joined == set()
    assert [each.key for each in back.interfaces.by("ann/r1")] == ["ann/r1/pose"]
    assert back.connections_of_user("bob") == state.connections_of_user("bob") == 3


async def test_longest_names_are_stored(store: Store, url: str) -> None:
    user, tag = "u" * 255, "t" * 255
    state = State()
    state.connections.put(Connection(f"{user}/{tag}/{tag}", f"{user}/{tag}/{tag}"))
    state.parameters.put(Parameter(f"{user}/{tag}", "\U0001f916" * 255, 1, tag))
    await store.save(state)
    assert everything(await loaded(url)) == everything(state)


async def test_changed_and_removed_records_are_stored(store: Store, url: str) -> None:
    state = full()
    await store.save(state)
    state.nodes.drop("ann/brain/n")
    state.environments.put(Environment("ann/brain", EnvironmentOptions(), "second", "m2"))
    state.environments.put(Environment("ann/short", EnvironmentOptions(), "r", "m2"))
    state.environments.drop("ann/short")
    await store.save(state)
    assert everything(await loaded(url)) == everything(state)


async def test_changes_during_a_write_are_written_together(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[set[str]] = []
    put = store_module._put

    def noting(connection: sa.Connection, rows: dict[tuple[str, str], str | None]) -> None:
        written.append({key for _, key in rows})
        put(connection, rows)

    monkeypatch.setattr(store_module, "_put", noting)
    state = State()

    def save(tag: str) -> Any:
        state.environments.put(Environment(tag, EnvironmentOptions(), "r", "m"))
        return store.save(state)

    saves = [save("a/1")]
    await asyncio.sleep(0)  # its write has begun
    saves += [save("a/2"), save("a/3")]
    await asyncio.gather(*saves)
    assert written == [{"a/1"}, {"a/2", "a/3"}]


async def test_change_is_acknowledged_while_others_go_on(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each write brings another change: who waits for the first must not wait for all of them."""
    state = State()
    put, written = store_module._put, 0
    more: list[asyncio.Future[None]] = []
    loop = asyncio.get_running_loop()

    def change() -> None:
        state.environments.put(Environment(f"a/{len(more)}", EnvironmentOptions(), "r", "m"))
        more.append(store.save(state))

    def endless(connection: sa.Connection, rows: dict[tuple[str, str], str | None]) -> None:
        nonlocal written
        written += 1
        if written < 100:
            done = threading.Event()
            loop.call_soon_threadsafe(lambda: (change(), loop.call_soon(done.set)))
            done.wait(10)
        put(connection, rows)

    monkeypatch.setattr(store_module, "_put", endless)
    change()
    await more[0]
    assert written <= 2
    written = 100
    await asyncio.gather(*more)


async def test_save_without_a_change_waits_for_the_write_under_way(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    go, put = threading.Event(), store_module._put

    def held(connection: sa.Connection, rows: dict[tuple[str, str], str | None]) -> None:
        go.wait(10)
        put(connection, rows)

    monkeypatch.setattr(store_module, "_put", held)
    state = full()
    first, second = (store.save(state) for _ in range(2))
    await asyncio.wait([first, second], timeout=0.01)
    assert not second.done()
    go.set()
    await asyncio.gather(first, second)


async def test_failed_write_does_not_fail_the_next(store: Store, url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    state, put, failures = full(), store_module._put, iter([OSError("disk is full")])

    def first_fails(connection: sa.Connection, rows: dict[tuple[str, str], str | None]) -> None:
        for failure in failures:
            raise failure
        put(connection, rows)

    monkeypatch.setattr(store_module, "_put", first_fails)
    first = store.save(state)
    await asyncio.sleep(0)  # its write has begun
    state.environments.put(Environment("a/late", EnvironmentOptions(), "r", "m"))
    await store.save(state)
    assert isinstance(first.exception(), OSError)
    assert everything(await loaded(url)) == everything(state)


async def test_full_database_is_reported_as_a_full_disk(tmp_path: Path) -> None:
    store = Store(f"sqlite:///{tmp_path / 'master.db'}")
    await store.open()
    await store.run(lambda db: db.execute(sa.text("PRAGMA max_page_count = 1")))
    state = State()
    state.environments.put(Environment("a/e", EnvironmentOptions(image="x" * 1_000_000), "r", "m"))
    with pytest.raises(DiskFull, match=r"disk full \(database: database or disk is full\)"):
        await store.save(state)
    with pytest.raises(DiskFull):
        await store.close()


async def test_failed_write_is_repeated_with_the_next(store: Store, url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    state = full()

    def broken(connection: sa.Connection, rows: object) -> None:
        raise OSError("disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(store_module, "_put", broken)
        with pytest.raises(OSError, match="disk is full"):
            await store.save(state)
    await store.save(state)
    assert everything(await loaded(url)) == everything(state)


async def test_database_is_closed_although_the_last_write_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(connection: sa.Connection, rows: object) -> None:
        raise OSError("disk is full")

    store = Store(f"sqlite:///{tmp_path / 'master.db'}")
    await store.open()
    monkeypatch.setattr(store_module, "_put", broken)
    with pytest.raises(OSError, match="disk is full"):
        await store.save(full())
    with pytest.raises(OSError, match="disk is full"):
        await store.close()
    assert os.listdir(tmp_path) == ["master.db"]  # SQLite removes the others with the last connection
    with pytest.raises(RuntimeError, match="after shutdown"):
        await store.run(lambda connection: None)


async def test_failed_transaction_is_rolled_back(store: Store) -> None:
    def work(connection: sa.Connection) -> None:
        connection.execute(db.tokens.insert(), {"digest": "d", "process": "p", "role": "robot", "used": False})
        raise KeyError("after the insert")

    with pytest.raises(KeyError):
        await store.run(work)
    assert await store.run(lambda connection: list(connection.execute(sa.select(db.tokens)))) == []


async def test_work_that_waits_shares_a_transaction_and_fails_alone(store: Store, url: str) -> None:
    go = threading.Event()
    held = asyncio.ensure_future(store.run(lambda _: go.wait(10)))
    commits = 0

    def count(_: sa.Connection) -> None:
        nonlocal commits
        commits += 1

    def insert(number: int) -> Any:
        def work(connection: sa.Connection) -> int:
            row = {"digest": f"d{number}", "process": "p", "role": "robot", "used": False}
            connection.execute(db.tokens.insert(), row)
            if number % 5 == 3:
                raise KeyError(number)
            return number

        return store.run(work)

    works = [asyncio.ensure_future(insert(number)) for number in (*range(20), 0)]
    await asyncio.sleep(0)  # all wait for the first one
    sa.event.listen(store._engine, "commit", count)
    go.set()
    await held
    results = await asyncio.gather(*works, return_exceptions=True)
    assert commits <= 2, "the first one's, and that of all others"
    assert [number for number in results if isinstance(number, int)] == [n for n in range(20) if n % 5 != 3]
    assert [error.args for error in results if isinstance(error, KeyError)] == [(3,), (8,), (13,), (18,)]
    assert isinstance(results[-1], sa.exc.IntegrityError), "its row exists"
    rows = await store.run(lambda connection: list(connection.execute(sa.select(db.tokens.c.digest))))
    assert {row.digest for row in rows} == {f"d{number}" for number in range(20) if number % 5 != 3}


@pytest.mark.parametrize("fails", [False, True])
async def test_reads_share_a_transaction_without_savepoints_and_fail_alone(store: Store, fails: bool) -> None:
    begun, go, savepoints = threading.Event(), threading.Event(), []

    def hold(_: sa.Connection) -> None:
        begun.set()
        go.wait(10)

    def write(connection: sa.Connection) -> None:
        connection.execute(db.tokens.insert(), {"digest": "d", "process": "p", "role": "robot", "used": False})

    def count(connection: sa.Connection) -> int:
        return len(list(connection.execute(sa.select(db.tokens))))

    def fail(connection: sa.Connection) -> None:
        connection.execute(sa.text("SELECT nothing FROM nowhere"))

    held = asyncio.ensure_future(store.run(hold))
    await asyncio.to_thread(begun.wait)
    works = [asyncio.ensure_future(work) for work in (store.read(count), store.run(write), store.read(count))]
    works += [asyncio.ensure_future(store.read(fail))] if fails else []
    sa.event.listen(store._engine, "savepoint", lambda *_: savepoints.append("of the one that writes"))
    await asyncio.sleep(0)
    go.set()
    await held
    results = await asyncio.gather(*works, return_exceptions=True)
    assert results[:3] == [0, None, 1]
    assert len(savepoints) == 1
    assert all(isinstance(error, sa.exc.SQLAlchemyError) for error in results[3:])


async def test_failed_commit_of_many_is_repeated_for_each(store: Store) -> None:
    go = threading.Event()
    held = asyncio.ensure_future(store.run(lambda _: go.wait(10)))
    fails = iter([True])

    def fail(connection: sa.Connection) -> None:
        if next(fails, False):
            raise sa.exc.OperationalError("flush", {}, OSError("disk is full"))

    def work(connection: sa.Connection) -> None:
        fail(connection)
        connection.execute(db.tokens.insert(), {"digest": "d", "process": "p", "role": "robot", "used": False})

    works = [asyncio.ensure_future(store.run(each)) for each in (lambda _: 1, work, lambda _: 2)]
    await asyncio.sleep(0)
    go.set()
    await held
    assert await asyncio.gather(*works) == [1, None, 2]
    assert len(await store.run(lambda connection: list(connection.execute(sa.select(db.tokens))))) == 1


@pytest.mark.parametrize("url", ["nonsense", "nosuch://x", "sqlite:////nowhere/at/all.db"])
async def test_unusable_database_is_reported(url: str) -> None:
    with pytest.raises(InvalidRequest, match="database") as raised:
        await Store(url).open()
    assert raised.value.field == "database"


async def test_database_in_memory(tmp_path: Path) -> None:
    store = Store("sqlite://")
    await store.open()
    state = full()
    await store.save(state)
    back = State()
    await store.load(back)
    assert everything(back) == everything(state)
    await store.close()


async def test_acknowledged_change_is_on_the_disk(tmp_path: Path) -> None:
    """SQLite flushes each transaction to the disk: 2 is FULL, 1 would lose the last ones in a power cut."""
    store = Store(f"sqlite:///{tmp_path / 'master.db'}")
    await store.open()
    assert await store.run(lambda db: db.execute(sa.text("PRAGMA synchronous")).scalar()) == 2
    await store.close()


async def test_database_file_is_private(tmp_path: Path) -> None:
    """It has hashes of passwords, and its directory may have any mode."""
    for name in ("new.db", "old.db"):
        file = tmp_path / name
        if name == "old.db":
            file.touch(mode=0o644)
        store = Store(f"sqlite:///{file}")
        await store.open()
        modes = [(tmp_path / f"{name}{more}").stat().st_mode & 0o777 for more in ("", "-wal", "-shm")]
        assert modes == [0o600] * 3
        await store.close()
