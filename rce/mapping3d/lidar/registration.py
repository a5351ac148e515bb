"""The motion between two clouds, and what it leaves open.

Points are laid on planes (Chen and Medioni, Object Modelling by Registration of Multiple Range Images, 1991) with a
kernel against wrong pairs. Only where the neighbours of a point span a plane it has one: on the floor the rings of a
spinning lidar are lines, and planes through them have any direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from rce.mapping3d.poses import Floats, Pose, inverse, make_pose, rigid, transform


@dataclass(frozen=True, slots=True)
class RegistrationSettings:
    """Settings of the registration.

    Attributes:
        neighbours: Points from which a plane is found.
        flat: Largest deviation from the plane as a share of its narrower extent.
        wide: Least narrower extent as a share of the wider one.
        reach: Largest distance of points that belong together, metres; a round for each, from coarse to fine.
        rounds: Most steps of each.
        still: Metres and radians below which a step ends a round.
        kernel: Distance from a plane from which on a pair counts less, as a share of the reach.
        facing: Least cosine between normals of points that belong together: a wall has two sides.
        close: Metres within which a point of one cloud agrees with a plane of the other.
        near: Metres within which a point must have a neighbour in the other cloud to be compared.
        noise: Standard deviation of a distance from point to plane, metres.
        independent: Points whose errors count as independent; those of neighbours are not.
    """

    neighbours: int = 12
    flat: float = 0.35
    wide: float = 0.3
    reach: tuple[float, ...] = (1.5, 0.6, 0.3)
    rounds: int = 10
    still: tuple[float, float] = (0.001, 0.0005)
    kernel: float = 0.3
    facing: float = 0.7
    close: float = 0.08
    near: float = 0.6
    noise: float = 0.05
    independent: int = 300


SETTINGS = RegistrationSettings()


class Surface:
    """Points that lie on planes.

    Attributes:
        points: (n, 3) metres.
        normals: (n, 3) unit vectors towards the lidar.
    """

    def __init__(self, points: NDArray[np.floating], settings: RegistrationSettings = SETTINGS) -> None:
        """Find the planes of a cloud (n, 3), thinned, frame of its lidar."""
        cloud = np.asarray(points, np.float64)
        self.points, self.normals = np.empty((0, 3)), np.empty((0, 3))
        if len(cloud) > settings.neighbours:
            self.points, self.normals = planes(cloud, settings)
        self.tree = cKDTree(self.points) if len(self.points) else None


def planes(cloud: Floats, settings: RegistrationSettings = SETTINGS) -> tuple[Floats, Floats]:
    """Return the points (n, 3) of a cloud (m, 3) whose neighbours span a plane, and its normals (n, 3)."""
    _, found = cKDTree(cloud).query(cloud, settings.neighbours)
    around = cloud[found] - cloud[found].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    thickness, narrow, wide = np.sqrt(np.maximum(values, 0.0)).T
    good = (thickness < settings.flat * narrow) & (narrow > settings.wide * wide)
    points, normals = cloud[good], vectors[good, :, 0]
    away = np.einsum("nk,nk->n", normals, points) > 0
    return points, np.where(away[:, None], -normals, normals)


@dataclass(frozen=True, slots=True)
class Registration:
    """Motion between two clouds.

    Attributes:
        pose: (4, 4) frame of the source to frame of the target.
        information: (6, 6) inverse covariance: translation, rotation, frame of the source.
        overlap: Share of the points of the source that are near the target.
        fit: Share of these that lie on its planes.
    """

    pose: Pose
    information: Floats
    overlap: float
    fit: float


def register(
    target: Surface,
    source: Surface,
    start: Pose,
    reach: Sequence[float] | None = None,
    settings: RegistrationSettings = SETTINGS,
) -> Registration:
    """Return the motion between two clouds.

    Args:
        target: One cloud.
        source: The other one.
        start: (4, 4) expected frame of the source to frame of the target.
        reach: Instead of that of the settings.
        settings: Settings.
    """
    pose = start
    if target.tree is not None and len(source.points):
        for each in settings.reach if reach is None else reach:
            pose = _align(target, source, pose, each, settings)
    return measured(target, source, pose, settings)


def _align(target: Surface, source: Surface, pose: Pose, reach: float, settings: RegistrationSettings) -> Pose:
    """Return a better pose: Gauss-Newton steps over the pairs of nearest points."""
    for _ in range(settings.rounds):
        # Pairs: the nearest point of the target on the same side of a wall.
        moved, normals, off, _ = _pairs(target, source, pose, reach, settings)
        if len(off) < 6:
            return pose
        # Weights of Geman and McClure (1987), as in KISS-ICP.
        width = (settings.kernel * reach) ** 2
        weights = (width / (width + off**2)) ** 2
        derivatives = np.concatenate([normals, np.cross(moved, normals)], axis=1)
        weighted = derivatives * weights[:, None]
        # A direction that the planes leave open stays as it was.
        matrix = weighted.T @ derivatives + 1e-3 * len(off) * np.diag([1e-3] * 3 + [1e-2] * 3)
        step = np.linalg.solve(matrix, -weighted.T @ off)
        pose = rigid(make_pose(Rotation.from_rotvec(step[3:]).as_matrix(), step[:3]) @ pose)
        if np.linalg.norm(step[:3]) < settings.still[0] and np.linalg.norm(step[3:]) < settings.still[1]:
            break
    return pose


def _pairs(
    target: Surface, source: Surface, pose: Pose, reach: float, settings: RegistrationSettings
) -> tuple[Floats, Floats, Floats, int]:
    """Return moved points (n, 3), the normals (n, 3) and distances (n,) of their planes, and how many were near."""
    assert target.tree is not None
    moved = transform(pose, source.points)
    distances, found = target.tree.query(moved, distance_upper_bound=reach)
    near = np.isfinite(distances)
    moved, normals = moved[near], target.normals[found[near]]
    facing = np.einsum("nk,nk->n", normals, source.normals[near] @ pose[:3, :3].T) > settings.facing
    moved, normals = moved[facing], normals[facing]
    off: Floats = np.einsum("nk,nk->n", normals, moved - target.points[found[near]][facing])
    return moved, normals, off, int(near.sum())


def measured(target: Surface, source: Surface, pose: Pose, settings: RegistrationSettings = SETTINGS) -> Registration:
    """Return how well a motion fits two clouds; its pose is the one that is given."""
    if target.tree is None or not len(source.points):
        return Registration(pose, np.zeros((6, 6)), 0.0, 0.0)
    moved, normals, off, near = _pairs(target, source, pose, settings.near, settings)
    good = np.abs(off) < settings.close
    back = inverse(pose)
    points, turned = transform(back, moved[good]), normals[good] @ back[:3, :3].T
    information = information_of(points, turned, settings)
    return Registration(pose, information, near / len(source.points), float(good.sum()) / max(near, 1))


def information_of(points: Floats, normals: Floats, settings: RegistrationSettings = SETTINGS) -> Floats:
    """Return the inverse covariance (6, 6) of a pose that was measured by distances from points to planes.

    It is the sum of the squares of their derivatives (Censi, An accurate closed-form estimate of ICP's covariance,
    2007, for planes without errors). A corridor leaves its direction open.

    Args:
        points: (n, 3), frame of the source.
        normals: (n, 3) of the planes, frame of the source.
        settings: Settings.
    """
    if not len(points):
        return np.zeros((6, 6))
    derivatives = np.concatenate([normals, np.cross(points, normals)], axis=1)
    share = min(1.0, settings.independent / len(points))
    information: Floats = share / settings.noise**2 * (derivatives.T @ derivatives)
    return information
