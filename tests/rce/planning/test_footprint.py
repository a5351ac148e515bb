"""Footprints: how they are written, and the cells that they cover."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.planning.footprint import Footprint


def test_radius_and_corners_are_parsed() -> None:
    assert Footprint.parse("0.3") == Footprint.circle(0.3)
    found = Footprint.parse("[[0.4, 0.2], [0.4, -0.2], [-0.2, -0.2], [-0.2, 0.2]]")
    assert math.isclose(found.inscribed, 0.2, rel_tol=1e-6)
    assert math.isclose(found.circumscribed, math.hypot(0.4, 0.2))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "round",
        "0",
        "-1",
        "true",
        "[[1,2]]",
        "[[1,1],[2,1],[2,2]]",
        "1e9",
        "[[0,1e9],[1,0],[-1,-1]]",
        "{}",
        "[1,2,3]",
    ],
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(InvalidRequest):
        Footprint.parse(text)


def test_samples_cover_the_outline_and_what_is_inside() -> None:
    samples = Footprint.parse("[[0.4, 0.2], [0.4, -0.2], [-0.2, -0.2], [-0.2, 0.2]]").samples(0.05)
    x, y = np.meshgrid(np.linspace(-0.2, 0.4, 50), np.linspace(-0.2, 0.2, 50))
    everywhere = np.stack([x.ravel(), y.ravel()], axis=1)
    gaps = np.hypot(*(everywhere[:, None] - samples[None]).transpose(2, 0, 1)).min(axis=1)
    assert gaps.max() < 0.05
    assert Footprint.circle(0.3).samples(0.05).shape == (0, 2)
