"""Tests of the order of samples."""

from __future__ import annotations

import pytest

from rce.bench import run
from rce.bench.floors import Sample
from rce.bench.nodes import Probe
from rce.bench.payloads import IMAGE


@pytest.fixture
def order(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    monkeypatch.setattr(run, "PAUSE", (0.0, 0.0))
    return []


def probe(order: list[tuple[str, int]], name: str, transport: str, size: int | None = None) -> Probe:
    async def sample(size: int) -> float:
        order.append((name, size))
        return float(len(order))

    taken: Sample = sample
    return Probe(name, transport, taken, "", size)


async def test_probes_take_turns_and_first_sample_is_discarded(order: list[tuple[str, int]]) -> None:
    steps: list[tuple[int, int]] = []
    probes = [probe(order, "a", "topic"), probe(order, "b", "service")]
    series = await run.take(probes, [10, 20], 2, lambda done, of: steps.append((done, of)))
    assert order == [(name, size) for size in (10, 20) for _ in range(3) for name in ("a", "b")]
    assert series[0].seconds == {10: [3.0, 5.0], 20: [9.0, 11.0]}
    assert steps == [(1, 2), (2, 2)]


async def test_images_are_measured_beside_bare_echoes_only(order: list[tuple[str, int]]) -> None:
    probes = [probe(order, "tcp", "floor"), probe(order, "string", "topic"), probe(order, "image", "topic", IMAGE)]
    await run.take(probes, [10], 1, lambda done, of: None)
    assert order == 2 * [("tcp", 10), ("string", 10)] + 2 * [("tcp", IMAGE), ("image", IMAGE)]
