"""When full collections run, and thresholds of the garbage collector."""

from __future__ import annotations

import gc
import math
import weakref
from collections.abc import Callable, Iterator

import pytest

from rce.process import garbage
from rce.process.garbage import SHORTEST, collect_seldom


class Later:
    """Keeps what is called later."""

    def __init__(self) -> None:
        self.calls: list[tuple[float, Callable[[], object]]] = []

    def __call__(self, delay: float, function: Callable[[], object]) -> None:
        self.calls.append((delay, function))


class Ring:
    """Refers to itself, so that only the collector frees it."""

    def __init__(self) -> None:
        self.itself = self


@pytest.fixture(autouse=True)
def restored() -> Iterator[None]:
    before = gc.get_threshold()
    yield
    gc.set_threshold(*before)


@pytest.fixture
def later() -> Later:
    return Later()


def test_python_begins_full_collections_seldom_and_young_ones_stay_short(later: Later) -> None:
    gc.set_threshold(700, 10, 10)
    before = math.prod(gc.get_threshold())
    collect_seldom(later)
    assert math.prod(gc.get_threshold()) >= 1000 * before
    assert gc.get_threshold()[0] <= 10_000, "young collections stay short"


def test_cycles_that_have_grown_old_are_freed(later: Later) -> None:
    ring = Ring()
    gone = weakref.ref(ring)
    for generation in (0, 1):
        gc.collect(generation)
    del ring
    collect_seldom(later)
    [(delay, collect)] = later.calls
    assert (delay, gone() is None) == (SHORTEST, False)
    collect()
    assert gone() is None


@pytest.mark.parametrize(("seconds", "delay"), [(0.001, SHORTEST), (0.02, 200.0), (1.2, 12_000.0)])
def test_collections_that_take_long_come_seldom(
    later: Later, monkeypatch: pytest.MonkeyPatch, seconds: float, delay: float
) -> None:
    collect_seldom(later)
    monkeypatch.setattr(garbage.time, "perf_counter", iter([5.0, 5.0 + seconds]).__next__)
    later.calls.pop()[1]()
    assert later.calls[0][0] == pytest.approx(delay)
