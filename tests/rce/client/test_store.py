"""Stores of publishers: in memory and in a file."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from rce.client.store import OVERHEAD, MessageStore, Store
from rce.errors import AlreadyExists, DiskFull, InvalidRequest

TYPE = "std_msgs/String"


def texts(store: MessageStore) -> list[bytes]:
    found, number = [], 0
    while (message := store.after(number)) is not None:
        found.append(message.body)
        number = message.number
    return found


@pytest.fixture(params=["memory", "file"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Store:
    return Store(tmp_path / "store" if request.param == "file" else None, max_bytes=1000)


def test_messages_stay_in_order_until_they_are_removed(place: Store) -> None:
    store = MessageStore(place, TYPE)
    numbers = [store.add(1.5, text, {"id": memoryview(b"blob")}) for text in (b"a", b"b", b"c")]
    assert texts(store) == [b"a", b"b", b"c"]
    first = store.after(0)
    assert first == (numbers[0], 1.5, b"a", {"id": b"blob"})
    store.remove(numbers[1])
    store.remove(numbers[1])
    assert texts(store) == [b"a", b"c"]


def test_numbers_rise_also_when_the_store_was_empty(place: Store) -> None:
    store = MessageStore(place, TYPE)
    first = store.add(0, b"a", {})
    store.remove(first)
    assert store.add(0, b"b", {}) > first


def test_oldest_messages_above_the_size_are_surplus_but_not_the_newest(place: Store) -> None:
    store = MessageStore(place, TYPE)
    for size in (400, 300, 2000):
        store.add(0, b"x" * (size - OVERHEAD), {})
    for number in store.surplus():
        store.remove(number)
    assert [len(text) for text in texts(store)] == [2000 - OVERHEAD]


def test_file_keeps_messages_and_state(tmp_path: Path) -> None:
    place = Store(tmp_path / "store", max_bytes=500)
    store = MessageStore(place, TYPE)
    stream = store.stream
    number = store.add(2.0, b"a", {"id": b"blob"})
    store.written(number, "incarnation")
    store.close()
    again = MessageStore(place, TYPE)
    assert (again.stream, again.sent, again.incarnation) == (stream, number, "incarnation")
    assert again.after(0) == (number, 2.0, b"a", {"id": b"blob"})
    again.add(0, b"x" * 450, {})
    assert list(map(int, again.surplus()))[:1] == [number], "the size of stored messages counts"


def test_file_in_use_of_another_type_or_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "store"
    store = MessageStore(Store(path), TYPE)
    with pytest.raises(AlreadyExists, match="in use by another publisher"):
        MessageStore(Store(path), TYPE)
    store.close()
    with pytest.raises(InvalidRequest, match="has messages of type std_msgs/String, not std_msgs/Bool"):
        MessageStore(Store(path), "std_msgs/Bool")
    (tmp_path / "text").write_text("no database, and long enough to be seen as none" * 10)
    with pytest.raises(InvalidRequest, match="text cannot be used"):
        MessageStore(Store(tmp_path / "text"), TYPE)
    with sqlite3.connect(tmp_path / "other") as other:
        other.execute("CREATE TABLE birds (name TEXT)")
    other.close()
    with pytest.raises(InvalidRequest, match="is a database, but no store"):
        MessageStore(Store(tmp_path / "other"), TYPE)
    with pytest.raises(InvalidRequest, match="nowhere"):
        MessageStore(Store(tmp_path / "nowhere" / "store"), TYPE)


def test_full_disk_is_told(tmp_path: Path) -> None:
    store = MessageStore(Store(tmp_path / "store"), TYPE)
    store._db.execute("PRAGMA max_page_count = 10")
    with pytest.raises(DiskFull, match="store"):
        store.add(0, b"x" * 100_000, {})
    store.add(0, b"small", {})
    assert texts(store) == [b"small"]
