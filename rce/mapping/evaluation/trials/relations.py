"""Error of a trajectory by relations between its poses.

Kümmerle et al., On Measuring the Accuracy of SLAM Algorithms, 2009. A relation is a pose in the frame of another one:
it needs no common frame with the ground truth, and separates errors over short distances from those over long ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rce.errors import InvalidRequest
from rce.mapping.geometry import wrap_angles

Array = NDArray[np.float64]
MAX_RELATIONS = 2000  # of each kind
NEAR_WAY = 2.0  # metres of way between the poses of a short relation
FAR_WAY = 20.0  # metres of way, at least, between the poses of a long relation, and between two visits of a place
REVISIT = 1.5  # metres between the true poses of two visits at most
SAME_STAMP = 0.05  # seconds between the stamp of a relation and that of a scan at most


@dataclass(frozen=True, slots=True)
class Relations:
    """True relations between poses.

    Attributes:
        ends: (n, 2) rows of the trajectory.
        motions: (n, 3) true second pose in the frame of the first; metres, radians.
    """

    ends: NDArray[np.int64]
    motions: Array


@dataclass(frozen=True, slots=True)
class Error:
    """Error of a trajectory; NaN without relations.

    Attributes:
        translation: Mean absolute error, metres.
        rotation: Mean absolute error, radians.
        worst: Largest error, metres.
        relations: Number of relations.
    """

    translation: float
    rotation: float
    worst: float
    relations: int


def error_of(trajectory: Array, relations: Relations) -> Error:
    """Return the error of a trajectory (n, 4) stamp, x, y, theta, one row a scan."""
    first, second = (trajectory[relations.ends[:, i], 1:] for i in (0, 1))
    off = _between(relations.motions, _between(first, second))
    length = np.hypot(off[:, 0], off[:, 1])
    if not len(length):
        return Error(float("nan"), float("nan"), float("nan"), 0)
    return Error(float(length.mean()), float(np.abs(off[:, 2]).mean()), float(length.max()), len(length))


def relations_of(truth: Array, seed: int = 0) -> dict[str, Relations]:
    """Return relations of a true trajectory (n, 4) by kind.

    `near`: 2 m of way apart. `far`: any two poses at least 20 m of way apart. `loop`: poses at the same place, at least
    20 m of way apart; their error is small only if loops are closed.
    """
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, 1:3], axis=0).T))])
    count = np.arange(len(truth))
    near = np.stack([count, np.searchsorted(way, way + NEAR_WAY)], axis=1)
    random = np.random.default_rng(seed)
    pairs = np.sort(random.integers(0, len(truth), (4 * MAX_RELATIONS, 2)), axis=1)
    visits = cKDTree(truth[:, 1:3]).query_pairs(REVISIT, output_type="ndarray").astype(np.int64)
    revisits = np.sort(visits, axis=1)
    chosen = {
        "near": near[near[:, 1] < len(truth)],
        "far": pairs[way[pairs[:, 1]] - way[pairs[:, 0]] > FAR_WAY],
        "loop": revisits[way[revisits[:, 1]] - way[revisits[:, 0]] > FAR_WAY],
    }
    return {kind: _relations(truth, _sample(ends, random)) for kind, ends in chosen.items()}


def read_relations(path: Path, stamps: Array) -> Relations:
    """Return the relations of a file with lines `stamp stamp x y z roll pitch yaw`.

    Args:
        path: The file.
        stamps: (n,) stamps of the scans; relations of other stamps are left out.

    Raises:
        InvalidRequest: The file has another format, or no relation of two of the scans.
    """
    try:
        rows = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise InvalidRequest(f"{path} cannot be read as relations: {error}", field="relations") from None
    if rows.shape[1] != 8:
        raise InvalidRequest(f"{path}: a relation must have 8 numbers, not {rows.shape[1]}", field="relations")
    ends = np.stack([_nearest(stamps, rows[:, 0]), _nearest(stamps, rows[:, 1])], axis=1)
    good = (np.abs(stamps[ends] - rows[:, :2]) < SAME_STAMP).all(axis=1)
    if not good.any():
        raise InvalidRequest(f"{path}: no relation has the stamps of two scans", field="relations")
    return Relations(ends[good], rows[good][:, [2, 3, 7]])


def _nearest(stamps: Array, wanted: Array) -> NDArray[np.int64]:
    """Return the rows of the stamps nearest to those wanted."""
    after = np.clip(np.searchsorted(stamps, wanted), 1, len(stamps) - 1)
    return np.where(wanted - stamps[after - 1] <= stamps[after] - wanted, after - 1, after)


def _sample(ends: NDArray[np.int64], random: np.random.Generator) -> NDArray[np.int64]:
    if len(ends) <= MAX_RELATIONS:
        return ends
    return ends[np.sort(random.choice(len(ends), MAX_RELATIONS, replace=False))]


def _relations(truth: Array, ends: NDArray[np.int64]) -> Relations:
    return Relations(ends, _between(truth[ends[:, 0], 1:], truth[ends[:, 1], 1:]))


def _between(first: Array, second: Array) -> Array:
    """Return the second poses (n, 3) in the frames of the first ones."""
    c, s = np.cos(first[:, 2]), np.sin(first[:, 2])
    dx, dy = (second - first)[:, 0], (second - first)[:, 1]
    return np.stack([c * dx + s * dy, c * dy - s * dx, wrap_angles(second[:, 2] - first[:, 2])], axis=1)
