"""Search for entries."""

from __future__ import annotations

from typing import Any

import pytest

from rce.api.knowledge import EntryChange, Location
from rce.errors import InvalidRequest
from rce.knowledge.records import Reader
from rce.knowledge.repository import Repository
from rce.knowledge.search import Search
from tests.support.knowledge import BED, CUP, KITCHEN, new_entry

ANN = Reader("ann")


async def found(repository: Repository, reader: Reader = ANN, **wanted: Any) -> list[str]:
    return [each.uid for each in (await repository.search(reader, Search(**wanted))).items]


@pytest.fixture
async def filled(repository: Repository) -> Repository:
    await repository.add("ann", new_entry(description="for espresso", location=Location(47.37, 8.54)))
    await repository.add("ann", new_entry(cls="bed", id="one", owl=BED, location=Location(48.13, 11.58)))
    await repository.add("ann", new_entry(kind="recipe", cls="make", id="bed", owl="", public=True))
    await repository.add("bob", new_entry(id="hers", owl=CUP.replace("blue", "green")))
    return repository


async def test_all_conditions_must_fit(filled: Repository) -> None:
    assert await found(filled) == ["bed.one", "cup.blue", "make.bed"]
    assert await found(filled, kind="recipe") == ["make.bed"]
    assert await found(filled, prefix="CUP.b") == ["cup.blue"]
    assert await found(filled, prefix="%") == []
    assert await found(filled, author="bob") == []
    assert await found(filled, Reader("bob"), author="bob", text="green") == ["cup.hers"]
    assert await found(filled, Reader("root", True), prefix="cup") == ["cup.blue", "cup.hers"]
    assert await found(filled, Reader("")) == ["make.bed"]


async def test_words_of_labels_names_and_descriptions_are_found(filled: Repository) -> None:
    for text in ("blue", "BLUE cup", "espr", "cup1"):
        assert await found(filled, text=text) == ["cup.blue"], text
    assert await found(filled, text='green" OR "') == []
    assert await found(filled, text="\0") == await found(filled)
    assert await found(filled, text="blue\0cup") == ["cup.blue"]
    assert await found(filled, text="espresso bed") == []


async def test_class_is_found_through_its_subclasses(filled: Repository) -> None:
    for cls in ("Cup", "vessel", "Thing", KITCHEN + "Thing"):
        assert await found(filled, cls=cls) == ["cup.blue"], cls
    assert await found(filled, cls="Bed") == ["bed.one"]
    assert await found(filled, cls=KITCHEN + "Nothing") == []


async def test_subclasses_count_that_another_readable_entry_names(filled: Repository) -> None:
    owl = f"<{KITCHEN}Bed> <http://www.w3.org/2000/01/rdf-schema#subClassOf> <{KITCHEN}Furniture> ."
    await filled.add("bob", new_entry(cls="ontology", id="furniture", owl=owl))
    assert await found(filled, cls="Furniture") == []
    await filled.add("bob", new_entry(cls="ontology", id="public", owl=owl, public=True))
    assert await found(filled, cls="Furniture") == ["bed.one", "ontology.public"]


async def test_place_is_within_the_radius(filled: Repository) -> None:
    near = {"latitude": 47.0, "longitude": 8.5}
    assert await found(filled, **near, radius=50_000) == ["cup.blue"]
    assert await found(filled, **near, radius=10_000) == []
    assert await found(filled, **near, radius=500_000) == ["bed.one", "cup.blue"]
    with pytest.raises(InvalidRequest, match="latitude and longitude"):
        await found(filled, latitude=3.0)


async def test_pages_have_all_entries_once(filled: Repository) -> None:
    after, seen = "", []
    while True:
        page = await filled.search(ANN, Search(limit=1, after=after))
        seen += [each.uid for each in page.items]
        if not page.next:
            break
        after = page.next
    assert seen == ["bed.one", "cup.blue", "make.bed"]


async def test_old_words_and_classes_are_forgotten(filled: Repository) -> None:
    await filled.change(ANN, "object", "cup.blue", EntryChange(owl=BED, description="for tea"))
    assert await found(filled, text="espresso") == []
    assert await found(filled, cls="Vessel") == []
    assert await found(filled, text="tea", cls="Bed") == ["cup.blue"]
