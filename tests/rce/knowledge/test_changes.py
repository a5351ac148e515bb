"""Subscriptions to changes."""

from __future__ import annotations

import json
from typing import Any

import pytest

from rce.api.knowledge import EntryChange
from rce.knowledge.changes import Subscription
from rce.knowledge.records import Reader
from rce.knowledge.repository import Repository
from rce.knowledge.writing import MAX_NOTED
from tests.support.knowledge import BED, KITCHEN, new_entry

ANN, BOB = Reader("ann"), Reader("bob")


@pytest.fixture
async def changed(repository: Repository) -> Repository:
    await repository.add("ann", new_entry(public=True))
    await repository.add("ann", new_entry(kind="environment", cls="room", id="one", owl=BED))
    await repository.change(ANN, "object", "cup.blue", EntryChange(description="new"))
    await repository.remove(ANN, "object", "cup.blue")
    return repository


async def told(repository: Repository, reader: Reader = ANN, after: int = 0, **wanted: Any) -> list[tuple[str, str]]:
    found, _ = await repository.changes(reader, Subscription(**wanted), after)
    return [(each.action, each.uid) for each in found]


CUP = [("added", "cup.blue"), ("changed", "cup.blue"), ("removed", "cup.blue")]
ROOM = [("added", "room.one")]


async def test_subscriber_gets_what_fits(changed: Repository) -> None:
    assert await told(changed) == [CUP[0], *ROOM, *CUP[1:]]
    assert await told(changed, kind="environment") == ROOM
    assert await told(changed, uid="Room.one") == ROOM
    assert await told(changed, prefix="cup") == CUP
    assert await told(changed, after=2, prefix="cup") == CUP[1:]


async def test_class_is_found_through_classes_below_it_also_when_the_entry_is_gone(changed: Repository) -> None:
    for cls in ("cup", "Thing", KITCHEN + "Thing"):
        assert await told(changed, cls=cls) == CUP, cls
    assert await told(changed, cls="Bed") == ROOM
    assert await told(changed, cls="Nothing") == []


async def test_nobody_is_told_of_what_they_may_not_read(changed: Repository) -> None:
    assert await told(changed, BOB) == CUP
    assert await told(changed, Reader("root", True), kind="environment") == ROOM


async def test_without_a_number_it_begins_with_the_next_change(changed: Repository) -> None:
    assert await changed.changes(ANN, Subscription(), None) == ([], 4)
    assert (await changed.changes(ANN, Subscription(), 4)) == ([], 4)


async def test_readers_are_told_when_an_entry_becomes_public_and_not_when_it_was(repository: Repository) -> None:
    await repository.add("ann", new_entry())
    await repository.change(ANN, "object", "cup.blue", EntryChange(public=True))
    assert await told(repository, BOB) == [("changed", "cup.blue")]
    await repository.change(ANN, "object", "cup.blue", EntryChange(public=False))
    assert await told(repository, BOB, after=2) == []


async def test_classes_that_are_noted_with_a_change_are_bounded(repository: Repository) -> None:
    classes = " ".join(f"<x:{number}> a <x:Class{number}> ." for number in range(MAX_NOTED + 100))
    await repository.add("ann", new_entry(owl=classes))
    noted = await repository.database.run(lambda connection: connection.execute("SELECT types FROM changes").fetchone())
    assert len(json.loads(noted[0])) == MAX_NOTED
