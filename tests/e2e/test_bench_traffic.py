"""`rce bench traffic` with a platform of its own."""

from __future__ import annotations

from tests.support.e2e.bench import bench


async def test_crowd_and_flood_are_measured() -> None:
    printed = await bench(400, "traffic", "--robots", "4", "--processes", "2", "--seconds", "1")
    (crowd,), (flood,) = printed["crowds"], printed["floods"]
    assert (crowd["sent"], crowd["received"], len(crowd["latencies"])) == (40, 40, 40)
    assert crowd["processes"] == 2
    assert flood["published"] >= flood["received"] > 0
