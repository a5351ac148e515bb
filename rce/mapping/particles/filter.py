"""Rao-Blackwellized particle filter: many hypotheses of the path of the robot, each with its own map."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points, Pose, wrap_angles
from rce.mapping.matching.fields import downsample
from rce.mapping.particles import kernels
from rce.mapping.particles.paths import Paths
from rce.mapping.particles.tiles import RATIO, UNIT, TileMaps
from rce.mapping.state import Reader, State

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """Settings of the particle filter.

    Attributes:
        noise: Metres; standard deviation of a measured point.
        spacing: Metres between the points that are matched.
        max_points: Maximum number of points that are matched.
        dependent: Number of points with the weight of one independent point, since the points of a scan share errors.
        iterations: Maximum number of iterations of the fit.
        jump: Log-likelihood by which a pose that the motion does not explain has to be likelier to be taken.
        smoothing: Points, for each particle, with the weight of one when particles are weighted: the gain (`ogain`) of
            GMapping. Without it all particles descend from one ancestor some 15 m ago, and none is right where a loop
            closes.
        resample_share: Share of effective particles below which the filter resamples.
        min_spread: Metres; standard deviation of a proposal along x and y at least, so that particles stay diverse.
        min_turn_spread: Radians; the same for the heading.
    """

    noise: float = 0.04
    spacing: float = 0.1
    max_points: int = 180
    dependent: float = 4.0
    iterations: int = 12
    jump: float = 6.0
    smoothing: float = 3.0
    resample_share: float = 0.5
    min_spread: float = 0.007
    min_turn_spread: float = math.radians(0.15)


SETTINGS = FilterSettings()
MIN_COVARIANCE = np.diag(np.square([SETTINGS.min_spread, SETTINGS.min_spread, SETTINGS.min_turn_spread]))


class ParticleFilter:
    """Rao-Blackwellized particle filter with an improved proposal and adaptive resampling.

    Grisetti, Stachniss and Burgard, Improved Techniques for Grid Mapping with Rao-Blackwellized Particle Filters, 2007
    (GMapping). The measurement is approximated by a Gaussian around the pose at which the scan fits the map of the
    particle best. Its product with the Gaussian of the motion is the proposal, and the integral of the product the
    weight, both in closed form; the paper samples poses around the best one instead (section III-B). Weights are
    smoothed, so that particles do not die by chance. Random numbers are drawn beforehand: the result does not depend on
    the number of cores.

    Attributes:
        count: Number of particles.
        poses: (count, 3) x, y, theta, metres and radians, map frame.
        log_weights: (count,) logarithms of the weights, up to a constant.
        paths: Paths of the particles.
        maps: Maps of the particles.
        random: Source of the random numbers.
    """

    def __init__(self, count: int, seed: int, cores: int = 0) -> None:
        """Start `count` particles at the origin, on this many cores (0: all)."""
        self.count = count
        self.poses = np.zeros((count, 3))
        self.log_weights = np.zeros(count)
        self.paths = Paths(count)
        self.maps = TileMaps(count)
        self.random = np.random.default_rng(seed)
        self._cores = min(cores or len(os.sched_getaffinity(0)), count)
        self._pool = ThreadPoolExecutor(self._cores, "particles") if self._cores > 1 else None

    @property
    def best(self) -> int:
        """Number of the particle with the largest weight."""
        return int(np.argmax(self.log_weights))

    def relocate(self, pose: Pose) -> None:
        """Continue with copies of the best particle at a pose in the map frame."""
        parents = np.full(self.count, self.best)
        self.paths.resample(parents)
        self.maps.resample(parents)
        self.poses, self.log_weights = np.tile(pose, (self.count, 1)), np.zeros(self.count)

    def state(self) -> State:
        """Return the filter as arrays to save."""
        return {
            "poses": self.poses.copy(),
            "log_weights": self.log_weights.copy(),
            "paths": self.paths.state(),
            "maps": self.maps.state(),
            "random": np.frombuffer(json.dumps(self.random.bit_generator.state).encode(), np.uint8),
        }

    def restore(self, saved: Reader) -> None:
        """Replace the filter by a saved one.

        Raises:
            InvalidRequest: The saved arrays are not a filter with as many particles.
        """
        self.poses = saved.array("poses", np.float64, self.count, 3)
        self.log_weights = saved.array("log_weights", np.float64, self.count)
        self.paths.restore(saved.part("paths"))
        self.maps.restore(saved.part("maps"))
        try:
            self.random.bit_generator.state = json.loads(bytes(saved.array("random", np.uint8, None)))
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            raise saved.invalid("random", f"is not the state of a random number generator ({error})") from None

    def move(self, motion: Pose, covariance: Array, points: Points | None, other: Pose | None = None) -> None:
        """Move all particles and weight them by a scan.

        Args:
            motion: Motion of the robot since the last step.
            covariance: (3, 3) of the motion, in the frame after it.
            points: Points of the scan (n, 2), metres, frame of the robot; None if they are too few to match.
            other: Second hypothesis of the motion, which every other particle takes.
        """
        motions = (motion, other or motion)
        spread = np.linalg.cholesky(covariance)
        starting, sampling = self.random.standard_normal((2, self.count, 3))
        # Motion model: the expected pose of each particle, and the covariance around it turned into the map frame.
        expected = np.array([Pose(*pose) @ motions[i % 2] for i, pose in enumerate(self.poses.tolist())])
        turns = _rotations(expected[:, 2])
        prior = turns @ covariance @ turns.swapaxes(1, 2)
        # A sample of the motion is where the scan matching of each particle starts.
        starts = expected + np.einsum("nij,jk,nk->ni", turns, spread, starting)
        if points is None:
            self.poses = starts
        else:
            self._propose(starts, expected, prior, points, sampling)
        self.paths.append(self.poses)

    def learn(self, points: Points) -> None:
        """Add points (n, 2), metres, frame of the robot, to all maps."""
        self._share(self.maps.learner(self.poses, points))

    def replace(self, path: Array, seen: Iterable[tuple[Pose, Points]]) -> None:
        """Continue with copies of one particle.

        Args:
            path: (n, 3) poses of the particle, metres and radians, map frame.
            seen: Points (n, 2) of its map, metres, each in the frame of a pose in the map frame.
        """
        maps = TileMaps(1)
        for pose, points in seen:
            maps.learner(np.array([pose]), points)(0, 1)
        maps.resample(np.zeros(self.count, np.int64))
        self.maps, self.paths = maps, Paths(self.count, path)
        self.poses, self.log_weights = np.tile(path[-1], (self.count, 1)), np.zeros(self.count)

    def resample(self) -> None:
        """Resample the particles by their weights if too few of them are effective.

        Adaptive resampling (Grisetti et al., 2007, section III-C; Doucet et al., 2000) with the systematic scheme of
        Carpenter, Clifford and Fearnhead, Improved Particle Filter for Nonlinear Problems, 1999.
        """
        # Effective sample size: 1 / sum of the squared normalised weights.
        weights = np.exp(self.log_weights - self.log_weights.max())
        weights /= weights.sum()
        if 1.0 / np.square(weights).sum() >= SETTINGS.resample_share * self.count:
            return
        # Systematic resampling: equidistant positions with one random offset in the cumulative weights.
        places = (self.random.random() + np.arange(self.count)) / self.count
        parents = np.minimum(np.searchsorted(np.cumsum(weights), places), self.count - 1)
        self.poses = self.poses[parents]
        self.log_weights = np.zeros(self.count)
        self.paths.resample(parents)
        self.maps.resample(parents)

    def _propose(self, starts: Array, expected: Array, prior: Array, points: Points, noise: Array) -> None:
        """Draw the poses from the proposal and update the weights.

        Args:
            starts: (count, 3) starts of the scan matching.
            expected: (count, 3) means of the motion model.
            prior: (count, 3, 3) covariances of the motion model, map frame.
            points: (n, 2), metres, frame of the robot.
            noise: (count, 3) standard normal numbers.
        """
        # Scan matching: the measurement as a Gaussian. For a particle that jumps, the motion is ignored.
        matched, precision, likelihood, jumped = self._match(starts, expected, points)
        off = np.where(jumped[:, None], 0.0, expected - matched)
        off[:, 2] = wrap_angles(off[:, 2])
        # Product of the two Gaussians: the proposal.
        both = precision + np.linalg.inv(prior)
        covariance = np.linalg.inv(both)
        towards = np.linalg.solve(prior, off[..., None])
        mean = matched + (covariance @ towards)[..., 0]
        # Integral of the product: the weight. `apart` is the squared Mahalanobis distance of the two means.
        apart = np.einsum("ni,nij,njk,nkl,nl->n", off, precision, covariance, np.linalg.inv(prior), off)
        shrink = np.linalg.slogdet(prior @ both)[1]
        evidence = likelihood - 0.5 * (apart + shrink) - SETTINGS.jump * jumped
        # Smooth the likelihood, and normalise the largest weight to 1.
        self.log_weights += evidence / max(1.0, SETTINGS.smoothing * self.count / SETTINGS.dependent)
        self.log_weights -= self.log_weights.max()
        # Sample from the proposal.
        self.poses = mean + np.einsum("nij,nj->ni", np.linalg.cholesky(covariance + MIN_COVARIANCE), noise)
        self.poses[:, 2] = wrap_angles(self.poses[:, 2])

    def _match(self, starts: Array, expected: Array, points: Points) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """Match points with the map of each particle.

        Returns:
            Poses (n, 3) in metres, map frame; inverse covariances (n, 3, 3); log-likelihoods (n,); and whether each
            pose is a jump, another place than expected (n,).
        """
        chosen = downsample(points, SETTINGS.spacing, SETTINGS.max_points)
        maps, found = self.maps, np.empty((self.count, 11))
        begin, middle, cells = maps.to_cells(starts), maps.to_cells(expected), chosen / UNIT
        variance = (SETTINGS.noise / UNIT) ** 2
        self._share(
            lambda i, j: kernels.match(
                maps.tiles,
                maps.tables,
                cells,
                begin,
                middle,
                found,
                RATIO,
                variance,
                SETTINGS.iterations,
                SETTINGS.jump * SETTINGS.dependent,
                i,
                j,
            )
        )
        scale = np.array([1.0 / UNIT, 1.0 / UNIT, 1.0])
        upper = found[:, [3, 4, 5, 4, 6, 7, 5, 7, 8]].reshape(-1, 3, 3)
        information = upper * np.outer(scale, scale) / SETTINGS.dependent
        return maps.from_cells(found[:, :3]), information, found[:, 9] / SETTINGS.dependent, found[:, 10] > 0

    def _share(self, work: Callable[[int, int], None]) -> None:
        """Call `work(begin, end)` for all particles, in one part for each core."""
        bounds = np.linspace(0, self.count, self._cores + 1).astype(int).tolist()
        if self._pool is None:
            work(0, self.count)
        else:
            list(self._pool.map(work, bounds[:-1], bounds[1:]))


def _rotations(angles: Array) -> Array:
    """Return matrices (n, 3, 3) that rotate x and y and keep theta."""
    c, s, zero, one = np.cos(angles), np.sin(angles), np.zeros_like(angles), np.ones_like(angles)
    return np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
