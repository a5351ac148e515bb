from __future__ import annotations

import cv2
import numpy as np

from rce.mapping3d.dense.mesh import Cloud, Mesh
from rce.mapping3d.dense.picture import PATHS, draw
from tests.support.rooms import looking

SQUARE = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]], np.float32)
UP = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
RED = np.tile(np.array([255, 0, 0], np.uint8), (4, 1))
FLOOR = Mesh(Cloud(SQUARE, UP, RED), np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def test_picture_shows_the_floor_and_the_path_of_each_robot() -> None:
    paths = {robot: [looking(0.5 + i * 0.1, 1 + robot, 0.5, 0) for i in range(20)] for robot in range(2)}
    image = cv2.imdecode(np.frombuffer(draw(FLOOR, paths, np.eye(4)), np.uint8), cv2.IMREAD_COLOR)
    red = (image[:, :, 2] > 200) & (image[:, :, 0] < 20) & (image[:, :, 1] < 20)
    assert red.mean() > 0.3
    for robot in range(2):
        assert (image == PATHS[robot]).all(axis=2).sum() > 300


def test_map_of_nothing_gives_a_picture() -> None:
    nothing = Mesh(Cloud(SQUARE[:0], UP[:0], RED[:0]), np.empty((0, 3), np.int32))
    assert draw(nothing, {0: []}, np.eye(4)).startswith(b"\x89PNG")
