"""Searches of the knowledge repository with many entries, without HTTP."""

from __future__ import annotations

import asyncio
import statistics
import tempfile
import time
from pathlib import Path

from msgspec import Struct

from rce.api.knowledge import KINDS, Location, NewEntry
from rce.knowledge.messages import Reading
from rce.knowledge.reading import read
from rce.knowledge.records import Reader
from rce.knowledge.repository import Repository, RepositoryLimits
from rce.knowledge.search import Search
from rce.knowledge.texts import Texts

AT_ONCE = 50  # entries that are added at the same time
CLASSES = 40  # below each other in chains of CHAIN
CHAIN = 4
COLOURS = ("red", "green", "blue", "white")
LIMIT = 50.0  # milliseconds that a search may take
SEARCHES = {
    "first page": Search(),
    "last page": Search(after="zzz"),
    "kind and prefix": Search(kind="object", prefix="class7.thing"),
    "word": Search(text="blue"),
    "two words": Search(text="blue thing42"),
    "class with those below": Search(cls="Class0"),
    "class and word": Search(cls="Class4", text="red"),
    "place": Search(latitude=47.0, longitude=8.0, radius=20_000),
    "author": Search(author="user3", kind="object"),
    "nothing": Search(text="nowhere"),
}


class OwnTexts(Texts):
    """Reads texts in this process: the bench trusts its own, and reads thousands."""

    async def read(self, user: str, base: str, text: str) -> Reading:
        """Read a text."""
        return read(base, text)


class Figure(Struct):
    """Times of one search.

    Attributes:
        search: What is searched for.
        found: Entries on the page.
        median: Milliseconds.
        largest: Milliseconds.
    """

    search: str
    found: int
    median: float
    largest: float


async def measure(entries: int, samples: int) -> list[Figure]:
    """Fill a repository of its own with objects, and measure searches of a user who may read half of them."""
    with tempfile.TemporaryDirectory(prefix="rce-bench-") as directory:
        repository = Repository(Path(directory), RepositoryLimits(user=1024**4, spare=0), OwnTexts())
        await repository.start()
        try:
            await _fill(repository, entries)
            return [await _measure(repository, name, search, samples) for name, search in SEARCHES.items()]
        finally:
            await repository.stop()


def table(figures: list[Figure], entries: int) -> str:
    """Return the figures as a table in Markdown, with a verdict."""
    rows = [f"| search of {entries:,} entries | found | median | largest |", "|---|---|---|---|"]
    rows += [f"| {each.search} | {each.found} | {each.median:.1f} ms | {each.largest:.1f} ms |" for each in figures]
    slowest = max(each.median for each in figures)
    rows.append(f"\nslowest median {slowest:.1f} ms: {'within' if slowest <= LIMIT else 'MORE THAN'} {LIMIT:g} ms")
    return "\n".join(rows)


def text_of(number: int) -> str:
    """Return the OWL text of an object."""
    own = number % CLASSES
    above = own - 1 if own % CHAIN else own
    return f"""@prefix k: <http://example.org/bench#> . @prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
k:Class{own} rdfs:subClassOf k:Class{above} .
k:thing{number} a k:Class{own} ; rdfs:label "the {COLOURS[number % len(COLOURS)]} thing{number}" ; k:height {number} .
"""


async def _fill(repository: Repository, entries: int) -> None:
    numbers = iter(range(entries))

    async def add() -> None:
        for number in numbers:
            place = Location(40 + number % 100 / 10, 5 + number % 70 / 10)
            kind, public = KINDS[1] if number % 10 else KINDS[0], number % 3 == 0
            cls, name = f"class{number % CLASSES}", f"thing{number}"
            new = NewEntry(kind, cls, name, text_of(number), f"number {number}", public, location=place)
            await repository.add(f"user{number % 10}", new)

    async with asyncio.TaskGroup() as group:
        for _ in range(AT_ONCE):
            group.create_task(add())


async def _measure(repository: Repository, name: str, search: Search, samples: int) -> Figure:
    times, found = [], 0
    for _ in range(samples):
        began = time.perf_counter()
        found = len((await repository.search(Reader("user3"), search)).items)
        times.append(1000 * (time.perf_counter() - began))
    return Figure(name, found, statistics.median(times), max(times))
