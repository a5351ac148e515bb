"""The bench of the knowledge repository."""

from __future__ import annotations

from rce.bench.knowledge import SEARCHES, Figure, measure, table, text_of
from rce.knowledge.reading import read


async def test_searches_find_what_they_should() -> None:
    found = {each.search: each.found for each in await measure(entries=44, samples=1)}
    assert list(found) == list(SEARCHES)
    assert found["nothing"] == found["last page"] == 0
    assert found["class with those below"] > found["class and word"] >= 0
    assert 0 < found["word"] < found["first page"]
    assert found["author"] > 0


def test_texts_are_read() -> None:
    assert read("http://a/", text_of(5)).count == 4


def test_verdict_is_that_of_the_slowest() -> None:
    figures = [Figure("word", 100, 3.14, 9.0), Figure("place", 2, 49.9, 80.0)]
    assert "| word | 100 | 3.1 ms | 9.0 ms |" in table(figures, 10_000)
    assert table(figures, 10_000).endswith("slowest median 49.9 ms: within 50 ms")
    assert "MORE THAN 50 ms" in table([Figure("word", 1, 50.1, 60.0)], 10)
