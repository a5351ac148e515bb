from __future__ import annotations

import numpy as np

from rce.mapping3d.evaluation.room import QVGA, render, sweep
from rce.mapping3d.frames import RgbdFrame
from rce.mapping3d.places.features import MAX_FEATURES, find_features

COLOR, DEPTH = render(sweep(0.1)[0][1], QVGA)


def test_features_have_their_places_in_space() -> None:
    features = find_features(RgbdFrame(0.0, COLOR, DEPTH), QVGA)
    assert 200 < len(features) <= MAX_FEATURES
    np.testing.assert_allclose(QVGA.project(features.points), features.pixels, atol=0.51)


def test_feature_without_depth_around_has_no_place() -> None:
    features = find_features(RgbdFrame(0.0, COLOR, np.zeros_like(DEPTH)), QVGA)
    assert len(features) > 200
    assert np.isnan(features.points).all()


def test_even_image_has_no_features() -> None:
    assert len(find_features(RgbdFrame(0.0, np.full_like(COLOR, 90), DEPTH), QVGA)) == 0
