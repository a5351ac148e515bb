from __future__ import annotations

import numpy as np

from rce.mapping3d.evaluation.room import QVGA, render, sweep
from rce.mapping3d.frames import RgbdFrame
from rce.mapping3d.places.features import Features, find_features
from rce.mapping3d.places.index import PlaceIndex


def view(begin: float) -> Features:
    return find_features(RgbdFrame(0.0, *render(sweep(0.1, begin=begin)[0][1], QVGA)), QVGA)


def test_nearby_view_is_ranked_first() -> None:
    index = PlaceIndex()
    for number in range(9):
        index.add(number, view(2.0 * number))
    assert len(index) == 9
    assert index.query(view(6.1))[0][0] == 3


def test_empty_index_and_empty_image_find_nothing() -> None:
    index = PlaceIndex()
    assert index.query(view(0.0)) == []
    index.add(0, view(0.0))
    nothing = Features(np.empty((0, 2), np.float32), np.empty((0, 32), np.uint8), np.empty((0, 3), np.float32))
    assert index.query(nothing) == []
