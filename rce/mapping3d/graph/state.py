"""State of a back end as one record, so that it can be saved and resumed."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from rce.errors import InvalidRequest
from rce.mapping3d.graph.pose_graph import Edge

NUMBERS = "<f8"
POSE, INFORMATION = 16, 36  # numbers
NO_CAMERA = (0, 0, 0.0, 0.0, 0.0, 0.0)  # of a key frame of a lidar


class SavedEdge(msgspec.Struct, array_like=True, frozen=True):
    """An `Edge`; the matrices are float64, little endian."""

    first: int
    second: int
    relative: bytes
    information: bytes
    loop: bool


class SavedKeyFrame(msgspec.Struct, array_like=True, frozen=True):
    """A key frame: names, where it is, and the sizes of its images or points in bytes.

    Attributes:
        robot: Number of the robot.
        index: Number among the key frames of this robot.
        stamp: Seconds.
        camera: width, height, fx, fy, cx, cy; all 0 if it is of a lidar.
        color: Bytes of the JPEG.
        depth: Bytes of the PNG.
        pose: (4, 4) float64, little endian, camera to the frame of the component.
        component: Number of the first node of the component.
        indexed: Whether other key frames may be recognised by it.
        cloud: Bytes of the points of a lidar.
    """

    robot: int
    index: int
    stamp: float
    camera: tuple[int, int, float, float, float, float]
    color: int
    depth: int
    pose: bytes
    component: int
    indexed: bool
    cloud: int = 0


class SavedGuess(msgspec.Struct, array_like=True, frozen=True):
    """A key frame at which a front end began anew, with the one before and a guess of the pose to it."""

    node: int
    before: int
    pose: bytes


class SavedMapper(msgspec.Struct, frozen=True):
    """State of a `KeyFrameMapper` without images."""

    loops: int
    key_frames: list[SavedKeyFrame]
    edges: list[SavedEdge]
    guesses: list[SavedGuess]
    pending: list[tuple[int, int, SavedEdge]]


def matrix(data: bytes, size: int) -> NDArray[np.float64]:
    """Return a square matrix of this many numbers.

    Raises:
        InvalidRequest: It has another size, or numbers that are not finite.
    """
    if len(data) != 8 * size or not np.isfinite(np.frombuffer(data, NUMBERS)).all():
        raise InvalidRequest("the session is damaged: a matrix is not complete")
    side = round(size**0.5)
    return np.frombuffer(data, NUMBERS).reshape(side, side).astype(np.float64)


def saved_edge(edge: Edge) -> SavedEdge:
    """Return an edge as it is saved."""
    relative, information = edge.relative.astype(NUMBERS).tobytes(), edge.information.astype(NUMBERS).tobytes()
    return SavedEdge(edge.first, edge.second, relative, information, edge.loop)


def edge_of(saved: SavedEdge, nodes: int) -> Edge:
    """Return a saved edge.

    Raises:
        InvalidRequest: It is damaged, or has a node that is not among the first `nodes`.
    """
    if not (0 <= saved.first < nodes and 0 <= saved.second < nodes):
        raise InvalidRequest("the session is damaged: an edge has no node")
    relative, information = matrix(saved.relative, POSE), matrix(saved.information, INFORMATION)
    return Edge(saved.first, saved.second, relative, information, saved.loop)
