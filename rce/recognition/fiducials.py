"""Fiducials: ArUco markers, AprilTags and QR codes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from rce.errors import InvalidRequest
from rce.recognition.camera import Floats, Picture

PREFIX = "DICT_"
DICTIONARIES: dict[str, int] = {
    name[len(PREFIX) :].lower(): value for name, value in vars(cv2.aruco).items() if name.startswith(PREFIX)
}
"""OpenCV's dictionaries by names such as `apriltag_36h11`, `4x4_50` and `aruco_original`."""


@dataclass(frozen=True, eq=False)
class Fiducial:
    """Fiducial in an image.

    Attributes:
        name: `DICTIONARY/NUMBER`, or `qr/TEXT`.
        corners: (4, 2) pixels, clockwise from the upper left corner of its print.
    """

    name: str
    corners: Floats


class MarkerFinder:
    """Finds the markers of one dictionary."""

    def __init__(self, dictionary: str) -> None:
        """Prepare a dictionary.

        Raises:
            InvalidRequest: There is no such dictionary.
        """
        if dictionary not in DICTIONARIES:
            known = ", ".join(sorted(DICTIONARIES))
            raise InvalidRequest(f"there is no dictionary {dictionary[:80]!r} of markers; use one of {known}")
        self._dictionary = dictionary
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        chosen = cv2.aruco.getPredefinedDictionary(DICTIONARIES[dictionary])
        self._detector = cv2.aruco.ArucoDetector(chosen, parameters)

    def find(self, picture: Picture) -> list[Fiducial]:
        """Return the markers in a grey image."""
        corners, numbers, _ = self._detector.detectMarkers(picture)
        if numbers is None:
            return []
        return [
            Fiducial(f"{self._dictionary}/{number}", np.asarray(each, np.float64).reshape(4, 2))
            for number, each in zip(numbers.ravel().tolist(), corners, strict=True)
        ]


class QrFinder:
    """Finds QR codes that can be read."""

    def __init__(self) -> None:
        self._detector = cv2.QRCodeDetector()

    def find(self, picture: Picture) -> list[Fiducial]:
        """Return the codes in a grey image."""
        found, texts, corners, _ = self._detector.detectAndDecodeMulti(picture)
        if not found:
            return []
        return [
            Fiducial(f"qr/{text}", np.asarray(each, np.float64).reshape(4, 2))
            for text, each in zip(texts, corners, strict=True)
            if text
        ]
