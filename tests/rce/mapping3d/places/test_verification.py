from __future__ import annotations

from rce.mapping3d.evaluation.room import QVGA, look, render
from rce.mapping3d.frames import KeyFrame, RgbdFrame
from rce.mapping3d.graph.views import View
from rce.mapping3d.places.verification import match_features, refine
from rce.mapping3d.poses import Pose, angle, distance, inverse

FIRST = look((3.0, 3.0, 1.5), (1.5, 1.0, 0.7))


def view(pose: Pose) -> View:
    return View(KeyFrame(0, 0, RgbdFrame(0.0, *render(pose, QVGA)), QVGA))


def test_same_place_from_another_side_is_found() -> None:
    second = look((2.7, 3.1, 1.45), (1.4, 1.1, 0.8), roll=0.2)
    reference, image = view(FIRST), view(second)
    match = match_features(reference.features, image.features, QVGA)
    assert match is not None
    found = refine(match, reference.reference, image.image)
    assert found is not None
    error = found.pose @ (inverse(FIRST) @ second)
    assert distance(error) < 0.005
    assert angle(error) < 0.003


def test_other_place_is_not_taken_for_the_same() -> None:
    reference, image = view(FIRST), view(look((3.0, 2.5, 1.5), (5.5, 4.0, 1.0)))
    match = match_features(reference.features, image.features, QVGA)
    assert match is None or refine(match, reference.reference, image.image) is None
