"""Pose between two images that may show the same place: from features, then from all pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.camera import Camera
from rce.mapping3d.odometry.alignment import Alignment, align
from rce.mapping3d.odometry.pyramid import Level, ReferenceLevel
from rce.mapping3d.places.features import Features
from rce.mapping3d.poses import Pose, make_pose, transform


@dataclass(frozen=True, slots=True)
class VerificationSettings:
    """Thresholds at which two images are taken to show the same place.

    Attributes:
        ratio: The best match of a feature must be closer than this share of the second best (Lowe, Distinctive Image
            Features from Scale-Invariant Keypoints, 2004, section 7.1).
        pixels: Largest distance of an inlier, pixels at a width of 320.
        inliers: Least number of matches that agree about the pose.
        share: Least share of the matches that agree.
        overlap: Least share of the points of one image that lie inside the other.
        fit: Least share of the points with depth in both whose depths agree.
        depth_error: Largest scale of the errors of depth, as a multiple of the expected noise.
        brightness_error: Largest scale of the errors of brightness.
        gain: Largest change of the exposure, as a factor.
    """

    ratio: float = 0.85
    pixels: float = 3.0
    inliers: int = 20
    share: float = 0.25
    overlap: float = 0.25
    fit: float = 0.75
    depth_error: float = 3.0
    brightness_error: float = 30.0
    gain: float = 3.0


SETTINGS = VerificationSettings()


@dataclass(frozen=True, slots=True)
class Match:
    """Pose from features.

    Attributes:
        pose: (4, 4) takes points of the reference to the camera frame of the image.
        inliers: Number of matches that agree.
        matches: Number of matches.
    """

    pose: Pose
    inliers: int
    matches: int


def match_features(reference: Features, image: Features, camera: Camera) -> Match | None:
    """Return the pose between two images from their features, None if too few agree.

    Perspective from points of the reference with depth, by RANSAC (Fischler and Bolles, 1981) with the solver of
    Lepetit, Moreno-Noguer and Fua (EPnP, 2009), refined by Levenberg-Marquardt over the inliers.

    Args:
        reference: Features of the reference.
        image: Features of the image.
        camera: Camera of the image.
    """
    pairs = _pairs(reference, image)
    if len(pairs) < SETTINGS.inliers:
        return None
    objects = reference.points[pairs[:, 0]].astype(np.float64)
    pixels = image.pixels[pairs[:, 1]].astype(np.float64)
    bound = SETTINGS.pixels * camera.width / 320
    cv2.setRNGSeed(0)
    good, turn, shift, chosen = cv2.solvePnPRansac(
        objects, pixels, camera.matrix, None, iterationsCount=300, reprojectionError=bound, flags=cv2.SOLVEPNP_EPNP
    )
    if not good or chosen is None or len(chosen) < SETTINGS.inliers:
        return None
    inside = chosen.ravel()
    turn, shift = cv2.solvePnPRefineLM(objects[inside], pixels[inside], camera.matrix, None, turn, shift)
    pose = make_pose(cv2.Rodrigues(turn)[0], np.ravel(shift))
    moved = transform(pose, objects)
    close = np.linalg.norm(camera.project(moved) - pixels, axis=1) < bound
    # The points in space must agree too where both images have depth: that excludes poses of a wrong scale.
    own = image.points[pairs[:, 1]]
    off = np.linalg.norm(own - moved, axis=1)
    agree = close & ~(off > 0.03 + 0.03 * moved[:, 2])
    count = int(agree.sum())
    if count < SETTINGS.inliers or count < SETTINGS.share * len(pairs):
        return None
    return Match(pose, count, len(pairs))


def refine(
    match: Match, reference: Sequence[ReferenceLevel], image: Sequence[Level], strict: bool = True
) -> Alignment | None:
    """Return the pose from all pixels, started at that of features; None if depths or colours do not agree."""
    found = align(reference, image, match.pose, first=min(2, len(image) - 1))
    return found if agrees(found, strict) else None


def agrees(found: Alignment, strict: bool = True) -> bool:
    """Return whether an alignment shows that two images see the same place.

    Args:
        found: The alignment.
        strict: False where the pose was known beforehand, so that little evidence is enough.
    """
    least = SETTINGS.fit if strict else 0.8 * SETTINGS.fit
    return (
        found.overlap >= SETTINGS.overlap
        and found.fit >= least
        and found.depth_error <= SETTINGS.depth_error
        and found.brightness_error <= SETTINGS.brightness_error
        and (1 / SETTINGS.gain < found.gain < SETTINGS.gain or not strict)
    )


def _pairs(reference: Features, image: Features) -> NDArray[np.int64]:
    """Return (n, 2) numbers of features that match; those of the reference have depth."""
    usable = np.flatnonzero(np.isfinite(reference.points).all(axis=1))
    if len(usable) < SETTINGS.inliers or len(image) < SETTINGS.inliers:
        return np.empty((0, 2), np.int64)
    matcher = cv2.BFMatcher.create(cv2.NORM_HAMMING)
    found = matcher.knnMatch(reference.descriptors[usable], image.descriptors, k=2)
    pairs = [
        (usable[best.queryIdx], best.trainIdx, best.distance)
        for best, second in (each for each in found if len(each) == 2)
        if best.distance < SETTINGS.ratio * second.distance and best.distance <= 64
    ]
    nearest: dict[int, tuple[int, int, float]] = {}
    for first, second_index, distance in pairs:  # one match for each feature of the image
        if second_index not in nearest or distance < nearest[second_index][2]:
            nearest[second_index] = (int(first), int(second_index), distance)
    return np.array([each[:2] for each in nearest.values()], np.int64).reshape(-1, 2)
