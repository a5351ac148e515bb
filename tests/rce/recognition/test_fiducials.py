"""Markers and codes in images; their poses are tested in test_recogniser.py."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.recognition.fiducials import DICTIONARIES, MarkerFinder, QrFinder
from tests.support.plane_scenes import marker, turned, view

WHERE = np.array([0.0, 0.0, 0.8])


@pytest.mark.parametrize("dictionary", ["apriltag_36h11", "apriltag_25h9", "4x4_50", "6x6_250", "aruco_original"])
def test_markers_are_found_by_name(dictionary: str) -> None:
    scene = view(marker(DICTIONARIES[dictionary], 7), 0.2, turned(0.3, 0.3), WHERE)
    (found,) = MarkerFinder(dictionary).find(scene)
    assert found.name == f"{dictionary}/7"
    assert found.corners[0, 0] < found.corners[1, 0]
    assert MarkerFinder("5x5_1000" if dictionary != "5x5_1000" else "7x7_50").find(scene) == []


def test_unknown_dictionary_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="apriltag_36h11"):
        MarkerFinder("runes")


def test_code_is_read() -> None:
    code = cv2.QRCodeEncoder.create().encode("shelf 12")
    code = cv2.resize(code, None, fx=8, fy=8, interpolation=cv2.INTER_NEAREST)
    scene = view(code, 0.2, turned(0.1, 0.2), WHERE)
    (found,) = QrFinder().find(scene)
    assert found.name == "qr/shelf 12"
    assert QrFinder().find(np.full((100, 100), 200, np.uint8)) == []
