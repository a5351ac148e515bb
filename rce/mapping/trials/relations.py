"""The error of a trajectory by relations of its poses (Kümmerle et al., On Measuring the Accuracy of SLAM Algorithms,
2009): where one pose is, seen from another, needs no common frame, and tells short distances from long ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rce.errors import InvalidRequest

Array = NDArray[np.float64]
MOST = 2000  # relations of a kind
NEAR_WAY = 2.0  # metres of way between the ends of a short relation
FAR_WAY = 20.0  # metres of way, at least, between those of a long one, and between two visits of a place
REVISIT = 1.5  # metres between the true poses of two visits
SAME = 0.05  # seconds between the stamp of a relation and that of a scan


@dataclass(frozen=True, slots=True)
class Relations:
    """`ends`: (n, 2) rows of the trajectory, `motions`: (n, 3) the second pose in the frame of the first, as it truly
    was: metres, radians."""

    ends: NDArray[np.int64]
    motions: Array


@dataclass(frozen=True, slots=True)
class Error:
    """Mean absolute error: `translation` in metres, `rotation` in radians, `worst` metres, and over how many relations.
    NaN where there are none."""

    translation: float
    rotation: float
    worst: float
    relations: int


def error_of(trajectory: Array, relations: Relations) -> Error:
    """`trajectory`: (n, 4) stamp, x, y, theta, one row a scan."""
    first, second = (trajectory[relations.ends[:, i], 1:] for i in (0, 1))
    off = _between(relations.motions, _between(first, second))
    length = np.hypot(off[:, 0], off[:, 1])
    if not len(length):
        return Error(float("nan"), float("nan"), float("nan"), 0)
    return Error(float(length.mean()), float(np.abs(off[:, 2]).mean()), float(length.max()), len(length))


def relations_of(truth: Array, seed: int = 0) -> dict[str, Relations]:
    """Relations of a true trajectory (n, 4): `near`: 2 m of way apart, `far`: any two at least 20 m of way apart, and
    `loop`: those of the far ones where the robot was at the same place, which are good only if loops are closed."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, 1:3], axis=0).T))])
    count = np.arange(len(truth))
    near = np.stack([count, np.searchsorted(way, way + NEAR_WAY)], axis=1)
    random = np.random.default_rng(seed)
    pairs = np.sort(random.integers(0, len(truth), (4 * MOST, 2)), axis=1)
    visits = cKDTree(truth[:, 1:3]).query_pairs(REVISIT, output_type="ndarray").astype(np.int64)
    revisits = np.sort(visits, axis=1)
    chosen = {
        "near": near[near[:, 1] < len(truth)],
        "far": pairs[way[pairs[:, 1]] - way[pairs[:, 0]] > FAR_WAY],
        "loop": revisits[way[revisits[:, 1]] - way[revisits[:, 0]] > FAR_WAY],
    }
    return {kind: _relations(truth, _some(ends, random)) for kind, ends in chosen.items()}


def read_relations(path: Path, stamps: Array) -> Relations:
    """The relations of a file with lines `stamp stamp x y z roll pitch yaw`, whose ends are scans with these stamps.

    InvalidRequest if it is no such file, or none of its relations fits.
    """
    try:
        rows = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise InvalidRequest(f"{path} cannot be read as relations: {error}", field="relations") from None
    if rows.shape[1] != 8:
        raise InvalidRequest(f"{path}: a relation has 8 numbers, not {rows.shape[1]}", field="relations")
    ends = np.stack([_nearest(stamps, rows[:, 0]), _nearest(stamps, rows[:, 1])], axis=1)
    good = (np.abs(stamps[ends] - rows[:, :2]) < SAME).all(axis=1)
    if not good.any():
        raise InvalidRequest(f"{path}: no relation has the stamps of two scans", field="relations")
    return Relations(ends[good], rows[good][:, [2, 3, 7]])


def _nearest(stamps: Array, wanted: Array) -> NDArray[np.int64]:
    after = np.clip(np.searchsorted(stamps, wanted), 1, len(stamps) - 1)
    return np.where(wanted - stamps[after - 1] <= stamps[after] - wanted, after - 1, after)


def _some(ends: NDArray[np.int64], random: np.random.Generator) -> NDArray[np.int64]:
    if len(ends) <= MOST:
        return ends
    return ends[np.sort(random.choice(len(ends), MOST, replace=False))]


def _relations(truth: Array, ends: NDArray[np.int64]) -> Relations:
    return Relations(ends, _between(truth[ends[:, 0], 1:], truth[ends[:, 1], 1:]))


def _between(first: Array, second: Array) -> Array:
    """The second poses (n, 3) in the frames of the first ones."""
    c, s = np.cos(first[:, 2]), np.sin(first[:, 2])
    dx, dy = (second - first)[:, 0], (second - first)[:, 1]
    turn = (second[:, 2] - first[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return np.stack([c * dx + s * dy, c * dy - s * dx, turn], axis=1)
