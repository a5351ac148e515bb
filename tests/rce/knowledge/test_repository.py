"""The repository."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from rce.api.knowledge import EntryChange, Location
from rce.errors import AlreadyExists, Forbidden, NotFound, Unavailable
from rce.knowledge.changes import Subscription
from rce.knowledge.messages import Reading
from rce.knowledge.names import graph_of
from rce.knowledge.records import Reader
from rce.knowledge.repository import Repository
from tests.support.knowledge import BED, new_entry

ANN, BOB, ROOT = Reader("ann"), Reader("bob"), Reader("root", True)


async def content() -> AsyncIterator[bytes]:
    yield b"content"


async def test_graph_of_an_entry_has_a_new_stamp_with_a_new_text_only(repository: Repository) -> None:
    await repository.add("ann", new_entry())
    graph = graph_of("object", "cup.blue")
    first = await repository.stamps(ANN)
    await repository.put_file(ANN, "object", "cup.blue", "a", content())
    await repository.change(ANN, "object", "cup.blue", EntryChange(public=True))
    assert await repository.stamps(BOB) == first
    await repository.change(ANN, "object", "cup.blue", EntryChange(owl=BED))
    assert (await repository.stamps(ANN))[graph] > first[graph]
    assert b"bed1" in (await repository.triples([graph, graph_of("object", "cup.gone")]))[graph]


async def test_location_is_set_and_removed(repository: Repository) -> None:
    place = Location(1.0, 2.0)
    assert (await repository.add("ann", new_entry(location=place))).location == place
    assert (await repository.change(ANN, "object", "cup.blue", EntryChange(location=None))).location is None


async def test_administrator_changes_entries_of_others(repository: Repository) -> None:
    await repository.add("ann", new_entry())
    changed = await repository.change(ROOT, "object", "cup.blue", EntryChange(description="x", shared=["bob"]))
    assert (changed.author, changed.modified_by, changed.version) == ("ann", "root", 2)
    for attempt in (
        repository.change(BOB, "object", "cup.blue", EntryChange(public=True)),
        repository.put_file(BOB, "object", "cup.blue", "a", content()),
        repository.remove(BOB, "object", "cup.blue"),
        repository.remove_version(BOB, "object", "cup.blue", 1),
    ):
        with pytest.raises(Forbidden, match="only ann"):
            await attempt
    with pytest.raises(NotFound):
        await repository.remove(BOB, "object", "nothing")


async def test_contents_that_two_entries_have_stay_with_the_second(repository: Repository, tmp_path: Path) -> None:
    for name in ("one", "two"):
        await repository.add("ann", new_entry(id=name))
        await repository.put_file(ANN, "object", f"cup.{name}", "a", content())
    await repository.remove(ANN, "object", "cup.one")
    assert (await repository.file(ANN, "object", "cup.two", "a")).read_bytes() == b"content"
    assert (await repository.text(ANN, "object", "cup.two")).text


async def test_uid_is_taken_once_when_two_come_at_the_same_time(repository: Repository) -> None:
    results = await asyncio.gather(
        *(repository.add(user, new_entry()) for user in ("ann", "bob")), return_exceptions=True
    )
    assert sorted(type(result).__name__ for result in results) == [AlreadyExists.__name__, "Entry"]


async def test_change_wakes_who_waits(repository: Repository) -> None:
    event = repository.next_change()
    await repository.add("ann", new_entry())
    assert event.is_set()
    assert not repository.next_change().is_set()


async def test_entry_is_removed_although_the_disk_is_full(
    repository: Repository, monkeypatch: pytest.MonkeyPatch
) -> None:
    await repository.add("ann", new_entry())
    monkeypatch.setattr(repository.contents, "_spare", 2**60)
    with pytest.raises(Unavailable, match="disk full"):
        await repository.add("ann", new_entry(id="red"))
    await repository.remove(ANN, "object", "cup.blue")
    assert (await repository.usage("ann")).entries == 0


async def test_change_of_the_description_keeps_a_text_that_comes_meanwhile(
    repository: Repository, monkeypatch: pytest.MonkeyPatch
) -> None:
    await repository.add("ann", new_entry())
    read = repository.texts.read

    async def overtaken(user: str, base: str, text: str) -> Reading:
        monkeypatch.setattr(repository.texts, "read", read)
        await repository.change(ANN, "object", "cup.blue", EntryChange(owl=BED))
        return await read(user, base, text)

    monkeypatch.setattr(repository.texts, "read", overtaken)
    changed = await repository.change(ANN, "object", "cup.blue", EntryChange(description="new"))
    assert (changed.version, changed.description) == (3, "new")
    assert (await repository.text(ANN, "object", "cup.blue")).text == BED
    graph = graph_of("object", "cup.blue")
    assert b"bed1" in (await repository.triples([graph]))[graph]


async def test_later_user_of_the_same_name_inherits_nothing(repository: Repository) -> None:
    await repository.add("ann", new_entry())
    await repository.add("bob", new_entry(id="shared"))
    await repository.change(BOB, "object", "cup.shared", EntryChange(shared=["ann", "eve"]))
    changes, _ = await repository.changes(ANN, Subscription(), 0)
    assert {each.uid for each in changes} == {"cup.blue", "cup.shared"}
    await repository.forget("ann")
    for uid in ("cup.blue", "cup.shared"):
        with pytest.raises(NotFound):
            await repository.entry(ANN, "object", uid)
    assert (await repository.changes(ANN, Subscription(), 0))[0] == []
    assert (await repository.entry(BOB, "object", "cup.shared")).shared == ["eve"]
    assert [each.uid for each in (await repository.changes(Reader("eve"), Subscription(), 0))[0]] == ["cup.shared"]
    await repository.add("ann", new_entry())
