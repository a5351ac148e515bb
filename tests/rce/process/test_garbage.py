"""Thresholds of the garbage collector."""

from __future__ import annotations

import gc
import math
from collections.abc import Iterator

import pytest

from rce.process.garbage import collect_seldom


@pytest.fixture(autouse=True)
def restored() -> Iterator[None]:
    before = gc.get_threshold()
    yield
    gc.set_threshold(*before)


def test_full_collections_are_seldom_and_young_ones_short() -> None:
    gc.set_threshold(700, 10, 10)
    before = math.prod(gc.get_threshold())
    collect_seldom()
    assert math.prod(gc.get_threshold()) >= 1000 * before
    assert gc.get_threshold()[0] <= 10_000, "young collections stay short"
