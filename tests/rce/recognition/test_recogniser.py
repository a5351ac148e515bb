"""Recognition in rendered images, and its accuracy."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from rce.recognition.fiducials import DICTIONARIES
from rce.recognition.recogniser import Recogniser, RecogniserSettings
from rce.recognition.textures import TextureModel
from tests.support.plane_scenes import CAMERA, angle_between, marker, texture, turned, view

ROTATION, TRANSLATION = turned(0.4, -0.5, 0.2), np.array([0.08, -0.04, 0.7])
BOX = TextureModel("box", texture(1), 0.3)


def test_pose_of_a_marker() -> None:
    settings = RecogniserSettings(dictionaries=["apriltag_36h11", "4x4_50"], sizes={"apriltag_36h11/3": 0.15})
    scene = view(marker(DICTIONARIES["apriltag_36h11"], 3), 0.15, ROTATION, TRANSLATION)
    (found,) = Recogniser(settings).find(scene, CAMERA)
    assert (found.name, found.score, found.size) == ("apriltag_36h11/3", 1.0, (0.15, 0.15))
    assert found.pose.translation == pytest.approx(TRANSLATION, abs=0.01)
    assert angle_between(found.pose.rotation, ROTATION) < 0.05


def test_pose_of_a_code() -> None:
    code = cv2.resize(cv2.QRCodeEncoder.create().encode("tea"), None, fx=8, fy=8, interpolation=cv2.INTER_NEAREST)
    code = code[16:-16, 16:-16]  # without its white border
    scene = view(np.asarray(code, np.uint8), 0.2, turned(0.1, 0.2), TRANSLATION)
    (found,) = Recogniser(RecogniserSettings(qr=True, qr_size=0.2)).find(scene, CAMERA)
    assert found.name == "qr/tea"
    assert found.pose.translation == pytest.approx(TRANSLATION, abs=0.03)


@pytest.mark.parametrize("method", ["orb", "sift"])
def test_pose_of_a_textured_object(method: str) -> None:
    scene = view(BOX.picture, BOX.width, ROTATION, TRANSLATION)
    settings = RecogniserSettings(models=[BOX], method=method)
    (found,) = Recogniser(settings).find(np.dstack([scene] * 3), CAMERA)
    assert (found.name, found.size) == ("box", (0.3, pytest.approx(0.2)))
    assert found.pose.translation == pytest.approx(TRANSLATION, abs=0.005)
    assert angle_between(found.pose.rotation, ROTATION) < 0.02
    assert np.sqrt(np.diag(found.pose.covariance)).max() < 0.02


@pytest.mark.parametrize("method", ["orb", "sift"])
def test_errors_of_textured_objects_are_as_large_as_the_covariances_say(method: str) -> None:
    """The normalized squared error of six dimensions is 6 on average."""
    random, squares = np.random.default_rng(1), []
    recogniser = Recogniser(RecogniserSettings(models=[BOX], method=method))
    for _ in range(8):
        rotation = turned(*random.uniform(-0.6, 0.6, 3))
        translation = np.array([*random.uniform(-0.1, 0.1, 2), random.uniform(0.6, 1.0)])
        for found in recogniser.find(view(BOX.picture, BOX.width, rotation, translation), CAMERA):
            turn = cv2.Rodrigues(found.pose.rotation @ rotation.T)[0].ravel()
            error = np.concatenate([found.pose.translation - translation, turn])
            squares.append(float(error @ np.linalg.solve(found.pose.covariance, error)))
    assert len(squares) >= 6
    assert float(np.median(squares)) < 15
