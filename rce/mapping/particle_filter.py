"""Many hypotheses of the way that the robot has gone, each with its map."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from rce.mapping import particle_kernels
from rce.mapping.fields import thin
from rce.mapping.geometry import Points, Pose
from rce.mapping.paths import Paths
from rce.mapping.state import Reader, State
from rce.mapping.tiles import RATIO, UNIT, TileMaps, reach_of

Array = NDArray[np.float64]
NOISE = 0.04  # metres; of a measured point
APART, MOST = 0.1, 180  # metres between the points that are matched, and their number
DEPENDENT = 4.0  # so many points say as much as one: those of a scan share their errors
ITERATIONS = 12
JUMP = 6.0  # logarithm of how much likelier a pose must be that the motion does not explain
# Points, for each particle, that say as much as one when particles are weighed: the gain (`ogain`) of GMapping. Without
# it all particles have one ancestor some 15 m ago, and none is right where a loop closes.
SMOOTHING = 3.0
ENOUGH = 0.5  # resample when fewer than this share of the particles counts
FLOOR = np.diag(np.square([0.007, 0.007, np.radians(0.15)]))  # covariance that a proposal has at least


class ParticleFilter:
    """The Rao-Blackwellized particle filter of Grisetti, Stachniss and Burgard (Improved Techniques for Grid Mapping
    with Rao-Blackwellized Particle Filters, 2007): the proposal takes the last scan into account, and particles are
    resampled only when their weights call for it.

    The measurement is approximated by a Gaussian around the pose at which the scan fits the map of the particle best.
    Its product with the Gaussian of the motion is the proposal, and its integral the weight, both in closed form, where
    the paper samples poses around the best one. Weights are smoothed, lest particles die of chance. Random numbers are
    drawn beforehand: the result does not depend on how many cores do the work.
    """

    def __init__(self, count: int, seed: int, cores: int = 0) -> None:
        self.count = count
        self.poses = np.zeros((count, 3))  # x, y, theta, metres and radians, map frame
        self.log_weights = np.zeros(count)
        self.paths = Paths(count)
        self.maps = TileMaps(count)
        self.random = np.random.default_rng(seed)
        self._cores = min(cores or len(os.sched_getaffinity(0)), count)
        self._pool = ThreadPoolExecutor(self._cores, "particles") if self._cores > 1 else None

    @property
    def best(self) -> int:
        """The particle with the largest weight."""
        return int(np.argmax(self.log_weights))

    def relocate(self, pose: Pose) -> None:
        """Go on with the best particle alone, at a pose in the map frame."""
        parents = np.full(self.count, self.best)
        self.paths.resample(parents)
        self.maps.resample(parents)
        self.poses, self.log_weights = np.tile(pose, (self.count, 1)), np.zeros(self.count)

    def state(self) -> State:
        return {
            "poses": self.poses.copy(),
            "log_weights": self.log_weights.copy(),
            "paths": self.paths.state(),
            "maps": self.maps.state(),
            "random": np.frombuffer(json.dumps(self.random.bit_generator.state).encode(), np.uint8),
        }

    def restore(self, saved: Reader) -> None:
        self.poses = saved.array("poses", np.float64, self.count, 3)
        self.log_weights = saved.array("log_weights", np.float64, self.count)
        self.paths.restore(saved.part("paths"))
        self.maps.restore(saved.part("maps"))
        try:
            self.random.bit_generator.state = json.loads(bytes(saved.array("random", np.uint8, None)))
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            raise saved.wrong("random", f"is no state of the random numbers ({error})") from None

    def move(self, motion: Pose, covariance: Array, points: Points | None, other: Pose | None = None) -> None:
        """Go on by a motion, known with a covariance (3, 3) in the frame after it, and see the points (n, 2), metres,
        frame of the robot; None if there are too few to match. Where the motion may be an `other` one as well, every
        second particle takes that."""
        motions = (motion, other or motion)
        spread = np.linalg.cholesky(covariance)
        starting, sampling = self.random.standard_normal((2, self.count, 3))
        expected = np.array([Pose(*pose) @ motions[i % 2] for i, pose in enumerate(self.poses.tolist())])
        turns = _turns(expected[:, 2])
        prior = turns @ covariance @ turns.swapaxes(1, 2)
        starts = expected + np.einsum("nij,jk,nk->ni", turns, spread, starting)
        if points is None:
            self.poses = starts
        else:
            self._propose(starts, expected, prior, points, sampling)
        self.paths.append(self.poses)

    def learn(self, points: Points) -> None:
        """Enter points (n, 2), metres, frame of the robot, in all maps."""
        self.maps.cover(self.poses, reach_of(points))
        self.maps.claim(self.poses, points)
        cells, scaled = self.maps.to_cells(self.poses), np.ascontiguousarray(points / UNIT)
        maps = self.maps
        self._share(lambda i, j: particle_kernels.learn(maps.tiles, maps.tables, cells, scaled, RATIO, i, j))

    def resample(self) -> None:
        """By their weights, at even distances from one random number (Carpenter et al., 1999), if these differ much."""
        weights = np.exp(self.log_weights - self.log_weights.max())
        weights /= weights.sum()
        if 1.0 / np.square(weights).sum() >= ENOUGH * self.count:
            return
        places = (self.random.random() + np.arange(self.count)) / self.count
        parents = np.minimum(np.searchsorted(np.cumsum(weights), places), self.count - 1)
        self.poses = self.poses[parents]
        self.log_weights = np.zeros(self.count)
        self.paths.resample(parents)
        self.maps.resample(parents)

    def _propose(self, starts: Array, expected: Array, prior: Array, points: Points, noise: Array) -> None:
        matched, precision, likelihood, jumped = self._match(starts, expected, points)
        off = np.where(jumped[:, None], 0.0, expected - matched)
        off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
        both = precision + np.linalg.inv(prior)
        covariance = np.linalg.inv(both)
        towards = np.linalg.solve(prior, off[..., None])
        mean = matched + (covariance @ towards)[..., 0]
        apart = np.einsum("ni,nij,njk,nkl,nl->n", off, precision, covariance, np.linalg.inv(prior), off)
        shrink = np.linalg.slogdet(prior @ both)[1]
        evidence = likelihood - 0.5 * (apart + shrink) - JUMP * jumped
        self.log_weights += evidence / max(1.0, SMOOTHING * self.count / DEPENDENT)
        self.log_weights -= self.log_weights.max()
        self.poses = mean + np.einsum("nij,nj->ni", np.linalg.cholesky(covariance + FLOOR), noise)
        self.poses[:, 2] = (self.poses[:, 2] + np.pi) % (2 * np.pi) - np.pi

    def _match(self, starts: Array, expected: Array, points: Points) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """Where each particle finds the points in its map: pose (n, 3) in metres, inverse covariance (n, 3, 3),
        log-likelihood (n,), and whether it is another place than expected."""
        chosen = thin(points, APART, MOST)
        maps, found = self.maps, np.empty((self.count, 11))
        begin, middle, cells = maps.to_cells(starts), maps.to_cells(expected), chosen / UNIT
        variance = (NOISE / UNIT) ** 2
        self._share(
            lambda i, j: particle_kernels.match(
                maps.tiles,
                maps.tables,
                cells,
                begin,
                middle,
                found,
                RATIO,
                variance,
                ITERATIONS,
                JUMP * DEPENDENT,
                i,
                j,
            )
        )
        scale = np.array([1.0 / UNIT, 1.0 / UNIT, 1.0])
        upper = found[:, [3, 4, 5, 4, 6, 7, 5, 7, 8]].reshape(-1, 3, 3)
        information = upper * np.outer(scale, scale) / DEPENDENT
        return maps.from_cells(found[:, :3]), information, found[:, 9] / DEPENDENT, found[:, 10] > 0

    def _share(self, work: Callable[[int, int], None]) -> None:
        """Do the work for all particles, in as many parts as there are cores."""
        bounds = np.linspace(0, self.count, self._cores + 1).astype(int).tolist()
        if self._pool is None:
            work(0, self.count)
        else:
            list(self._pool.map(work, bounds[:-1], bounds[1:]))


def _turns(angles: Array) -> Array:
    """Rotations (n, 3, 3) of x, y, theta."""
    c, s, zero, one = np.cos(angles), np.sin(angles), np.zeros_like(angles), np.ones_like(angles)
    return np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
