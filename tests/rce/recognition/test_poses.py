"""Poses from points, and whether their covariances say how far off they are."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from rce.recognition.camera import project
from rce.recognition.poses import find_pose, rectangle
from tests.support.plane_scenes import CAMERA, angle_between, turned

ROTATION, TRANSLATION = turned(0.5, -0.6, 0.3), np.array([0.1, -0.05, 0.9])
POINTS = np.concatenate([rectangle(0.2, 0.2), rectangle(0.1, 0.15)])
PIXELS, _ = project(POINTS, cv2.Rodrigues(ROTATION)[0], TRANSLATION, CAMERA)


def test_exact_points_give_the_exact_pose() -> None:
    pose = find_pose(POINTS, PIXELS, CAMERA)
    assert pose is not None
    assert pose.translation == pytest.approx(TRANSLATION, abs=1e-6)
    assert angle_between(pose.rotation, ROTATION) < 1e-5
    assert pose.error < 1e-4
    x, y, z, w = pose.quaternion
    back = cv2.Rodrigues(np.array([x, y, z]) / math.sin(math.acos(w)) * 2 * math.acos(w))[0]
    assert angle_between(back, ROTATION) < 1e-5


def test_errors_are_as_large_as_the_covariance_says() -> None:
    """The normalized squared error of six dimensions is 6 on average, and rarely above 20."""
    random, squares = np.random.default_rng(0), []
    for _ in range(200):
        pose = find_pose(POINTS, PIXELS + random.normal(0.0, 1.0, PIXELS.shape), CAMERA)
        assert pose is not None
        turn = cv2.Rodrigues(pose.rotation @ ROTATION.T)[0].ravel()
        error = np.concatenate([pose.translation - TRANSLATION, turn])
        squares.append(float(error @ np.linalg.solve(pose.covariance, error)))
    assert 4.0 < float(np.mean(squares)) < 10.0  # the noise itself is estimated, from ten numbers
    assert float(np.median(squares)) < 9.0


def test_depth_is_less_certain_than_the_rest_and_far_objects_less_than_near_ones() -> None:
    near = find_pose(POINTS, PIXELS, CAMERA)
    pixels, _ = project(POINTS, cv2.Rodrigues(ROTATION)[0], 3 * TRANSLATION, CAMERA)
    far = find_pose(POINTS, pixels, CAMERA)
    assert near is not None
    assert far is not None
    deviations = np.sqrt(np.diag(near.covariance))
    assert deviations[2] > 2 * deviations[:2].max()
    assert (np.diag(far.covariance) > np.diag(near.covariance)).all()


def test_second_solution_that_fits_as_well_is_part_of_the_covariance() -> None:
    """A small square from the front may be turned either way."""
    square, where = rectangle(0.05, 0.05), np.array([0.0, 0.0, 3.0])
    pixels, _ = project(square, cv2.Rodrigues(turned(0.2, 0.0))[0], where, CAMERA)
    pose = find_pose(square, np.round(pixels), CAMERA)
    assert pose is not None
    assert np.sqrt(np.diag(pose.covariance)[3:]).max() > 0.1


def test_points_on_a_line_determine_no_pose() -> None:
    line = np.array([(x, 0.0, 0.0) for x in (-0.1, 0.0, 0.1, 0.2)])
    pixels, _ = project(line, cv2.Rodrigues(ROTATION)[0], TRANSLATION, CAMERA)
    assert find_pose(line, pixels, CAMERA) is None
