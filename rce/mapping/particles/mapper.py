"""Mapper `particle`: many hypotheses of the path of the robot."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.grid import GridMap, OccupancyGrid
from rce.mapping.history import History
from rce.mapping.laser_odometry import LaserOdometry
from rce.mapping.mapper import MIN_POINTS, UNMATCHED_COVARIANCE, Estimate, MapperSettings
from rce.mapping.particles import filter as particle_filter
from rce.mapping.particles.filter import ParticleFilter
from rce.mapping.particles.path_graph import PathGraph
from rce.mapping.pose_graph.graph import rotation_matrix
from rce.mapping.scans import Scan
from rce.mapping.state import Reader, State, optional


@dataclass(frozen=True, slots=True)
class ParticleMapperSettings:
    """Settings of the mapper around the filter.

    Attributes:
        step: Metres between two steps of the filter.
        step_turn: Radians between two steps of the filter.
        spread: Metres; standard deviation of the motion between two steps at least.
        turn_spread: Radians; the same for the heading.
        lost_spread: Metres; standard deviation of a motion that scan matching does not determine.
        lost_turn_spread: Radians; the same for the heading.
        doubt: Metres by which the motions by wheels and by laser may differ. Beyond, one of them must be wrong: wheels
            slip, and in a corridor a scan may fit best where the last one was.
        doubt_share: The same as a share of the motion by the wheels; the larger of the two counts.
    """

    step: float = 0.5
    step_turn: float = 0.25
    spread: float = 0.015
    turn_spread: float = math.radians(0.25)
    lost_spread: float = 0.5
    lost_turn_spread: float = math.radians(15)
    doubt: float = 0.3
    doubt_share: float = 0.3


SETTINGS = ParticleMapperSettings()
MIN_COVARIANCE = np.diag(np.square([SETTINGS.spread, SETTINGS.spread, SETTINGS.turn_spread]))
LOST_COVARIANCE = np.diag(np.square([SETTINGS.lost_spread, SETTINGS.lost_spread, SETTINGS.lost_turn_spread]))


class ParticleMapper:
    """Mapper with a Rao-Blackwellized particle filter (see `ParticleFilter`) behind laser odometry.

    Between two steps of the filter the laser odometry moves the robot. The map and the trajectory are those of
    the particle with the largest weight. A loop closes when another particle takes over, or when the path is corrected
    (see `PathGraph`); the grid is rendered anew then.
    """

    def __init__(self, settings: MapperSettings | None = None) -> None:
        """Start an empty map at the origin."""
        self.settings = settings or MapperSettings()
        self._filter = ParticleFilter(self.settings.particles, self.settings.seed, self.settings.cores)
        self._odometry = LaserOdometry(self.settings.max_range)
        self._history = History()
        self._stamp = -math.inf
        self._step_pose: Pose | None = None  # pose of the laser odometry at the last step
        self._step_wheel_pose = ORIGIN  # its `wheel_pose` at the last step
        self._step_count = 0  # number of scans that it had kept at the last step
        self._lost = False  # whether a scan since the last step was not matched
        self._graph = PathGraph()
        self._grid = GridMap(self.settings.resolution)
        self._drawn = np.empty((0, 3))  # poses of the sweeps that are in the grid

    def add(self, scan: Scan) -> Estimate:
        """Map the next scan. One that is not newer than those before is answered but not mapped."""
        if not scan.stamp > self._stamp:
            return self._answer_late(scan)
        self._stamp = scan.stamp
        points = scan.points(self.settings.max_range)
        usable = points if len(points) >= MIN_POINTS else None
        found = self._odometry.add(scan, usable)
        covariance = found.covariance if found else UNMATCHED_COVARIANCE
        self._lost |= found is None
        self._step(usable, covariance)
        pose, since = self._filter.poses[self._filter.best], self._since()
        self._history.append(scan.stamp, len(self._filter.paths) - 1, since)
        return Estimate(scan.stamp, Pose(*pose.tolist()) @ since, covariance, found is not None)

    def grid(self) -> OccupancyGrid:
        """Return the map of the best particle."""
        self._graph.follow(self._filter.paths.path(self._filter.best))
        sweeps = list(self._graph.sweeps())
        poses = np.array([pose for pose, _ in sweeps]).reshape(-1, 3)
        if not np.array_equal(poses[: len(self._drawn)], self._drawn):
            self._grid, self._drawn = GridMap(self.settings.resolution), np.empty((0, 3))
        for pose, sweep in sweeps[len(self._drawn) :]:
            self._grid.insert(*sweep.seen_from(pose))
        self._drawn = poses
        return self._grid.render()

    def trajectory(self) -> NDArray[np.float64]:
        """Return (n, 4) stamp, x, y, theta of every accepted scan by the best particle, map frame."""
        return self._history.trajectory(self._filter.paths.path(self._filter.best))

    def relocate(self, pose: Pose) -> None:
        """Continue at a pose (map frame) to which the robot was carried while nothing was recorded."""
        self._filter.relocate(pose)
        self._graph.relocate(self._filter.paths.path(self._filter.best), pose)
        self._odometry = LaserOdometry(self.settings.max_range)
        self._step_pose, self._step_wheel_pose, self._step_count, self._lost = None, ORIGIN, 0, False

    def state(self) -> State:
        """Return the mapper as arrays to save."""
        return {
            "filter": self._filter.state(),
            "odometry": self._odometry.state(),
            "history": self._history.state(),
            "stamp": np.array([self._stamp] if math.isfinite(self._stamp) else [], np.float64),
            "then": optional(self._step_pose),
            "rolled": optional(self._step_wheel_pose),
            "seen": np.array(self._step_count, np.int64),
            "lost": np.array(self._lost),
            "graph": self._graph.state(),
            "grid": self._grid.state(),
            "drawn": self._drawn.copy(),
        }

    @classmethod
    def restored(cls, settings: MapperSettings, saved: Reader) -> ParticleMapper:
        """Return a mapper that continues where a saved one stopped.

        Raises:
            InvalidRequest: The saved arrays are not the state of this mapper with these settings.
        """
        mapper = cls(settings)
        mapper._filter.restore(saved.part("filter"))
        mapper._odometry.restore(saved.part("odometry"))
        count = len(mapper._filter.paths)
        mapper._history.restore(saved.part("history"), count)
        mapper._stamp = max(saved.array("stamp", np.float64, None).tolist(), default=-math.inf)
        mapper._step_pose, mapper._lost = saved.optional("then"), bool(saved.array("lost", np.bool_))
        mapper._step_wheel_pose = saved.optional("rolled") or ORIGIN
        mapper._step_count = saved.whole("seen", mapper._odometry.count + 1)
        mapper._graph = PathGraph.restored(saved.part("graph"), count)
        mapper._grid.restore(saved.part("grid"))
        mapper._drawn = saved.array("drawn", np.float64, None, 3)
        if len(mapper._drawn) > sum(1 for _ in mapper._graph.sweeps()):
            raise saved.invalid("drawn", "has more poses than the mapper has scans")
        return mapper

    def _answer_late(self, scan: Scan) -> Estimate:
        """Return the pose at the stamp of a scan that comes too late to be mapped."""
        pose = ORIGIN
        if len(self._history):
            step, since = self._history.at(scan.stamp)
            pose = Pose(*self._filter.paths.path(self._filter.best)[step].tolist()) @ since
        return Estimate(scan.stamp, pose, UNMATCHED_COVARIANCE, matched=False, accepted=False)

    def _since(self) -> Pose:
        """Return the motion since the last step."""
        return self._step_pose.to(self._odometry.pose) if self._step_pose else ORIGIN

    def _step(self, points: Points | None, covariance: NDArray[np.float64]) -> None:
        """Take a step of the filter if the robot has moved far enough."""
        motion, by_wheels = self._since(), self._step_wheel_pose.to(self._odometry.wheel_pose)
        if (
            self._step_pose is not None
            and not motion.exceeds(SETTINGS.step, SETTINGS.step_turn)
            and not by_wheels.exceeds(SETTINGS.step, SETTINGS.step_turn)
        ):
            return
        doubted = math.dist(motion[:2], by_wheels[:2]) > max(
            SETTINGS.doubt, SETTINGS.doubt_share * math.hypot(*by_wheels[:2])
        )
        # Scans kept since the last step are matched together with the current one, unless their poses are in doubt.
        since = self._odometry.count if doubted else self._step_count
        seen = None if points is None else np.concatenate([points, self._odometry.local_points(since)])
        if self._step_pose is None:
            self._filter.paths.append(self._filter.poses)
        else:
            self._filter.move(motion, self._spread(covariance), seen, by_wheels if doubted else None)
        if points is not None and seen is not None:
            self._filter.learn(seen)
        self._close_loops(points, covariance)
        self._step_pose, self._step_wheel_pose = self._odometry.pose, self._odometry.wheel_pose
        self._step_count, self._lost = self._odometry.count, False
        self._filter.resample()

    def _spread(self, covariance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance (3, 3) of the motion in the frame of the robot.

        Args:
            covariance: (3, 3) of the last match, frame of the laser odometry.
        """
        if self._lost:
            return LOST_COVARIANCE
        c, s = math.cos(self._odometry.pose.theta), math.sin(self._odometry.pose.theta)
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        known = np.linalg.inv(particle_filter.SETTINGS.dependent * turn @ covariance @ turn.T) + np.linalg.inv(
            LOST_COVARIANCE
        )
        return np.asarray(MIN_COVARIANCE + np.linalg.inv(known), np.float64)

    def _close_loops(self, points: Points | None, covariance: NDArray[np.float64]) -> None:
        """Add the step to the graph of the best path, and correct all paths if it finds a loop that they do not close.

        Args:
            points: Points (n, 2) of the scan, metres, frame of the robot; None if they are too few.
            covariance: (3, 3) of the last match, frame of the laser odometry.
        """
        path = self._filter.paths.path(self._filter.best)
        turn = rotation_matrix(path[-1, 2] - self._odometry.pose.theta)
        known = UNMATCHED_COVARIANCE if self._lost else turn @ covariance @ turn.T
        corrected = self._graph.extend(path, points, known)
        if corrected is not None:
            seen = ((pose, sweep.points.astype(np.float64)) for pose, sweep in self._graph.sweeps())
            self._filter.replace(corrected, seen)
