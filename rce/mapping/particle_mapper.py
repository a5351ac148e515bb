"""The mapper that keeps many hypotheses."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.graph import Sweep
from rce.mapping.grid import GridMap, OccupancyGrid
from rce.mapping.history import History
from rce.mapping.laser_odometry import LaserOdometry
from rce.mapping.mapper import FEWEST_POINTS, UNCERTAIN, Estimate, MapperSettings
from rce.mapping.particle_filter import ParticleFilter
from rce.mapping.scans import Scan
from rce.mapping.state import Reader, State, optional, pack

MOVE, TURN = 0.5, 0.25  # metres, radians between two steps of the filter
DRAW_MOVE, DRAW_TURN = 0.4, 0.2  # metres, radians between scans that are drawn in the grid; less than the above
SPREAD = np.diag(np.square([0.03, 0.03, math.radians(0.5)]))  # covariance of a motion between two steps, at least
LOST = np.diag(np.square([0.5, 0.5, math.radians(15)]))  # of one of which the walls say nothing
# Metres, and share of the way by the wheels, by which these and the laser differ where one must be wrong: wheels slip,
# and in a corridor a scan may fit best where the last one was.
DOUBT, DOUBT_SHARE = 0.3, 0.3
DEPENDENT = 4.0  # see particle_filter.DEPENDENT


class ParticleMapper:
    """A Rao-Blackwellized particle filter (see `ParticleFilter`) behind laser odometry (see `LaserOdometry`).

    Between two steps of the filter the robot moves as the laser odometry says. The map and the trajectory are those of
    the likeliest particle; when another one takes over, which is how a loop closes, the grid is rendered anew.
    """

    def __init__(self, settings: MapperSettings | None = None) -> None:
        self.settings = settings or MapperSettings()
        self._filter = ParticleFilter(self.settings.particles, self.settings.seed, self.settings.cores)
        self._odometry = LaserOdometry(self.settings.max_range)
        self._history = History()
        self._stamp = -math.inf
        self._then: Pose | None = None  # of the laser odometry at the last step
        self._rolled = ORIGIN  # of its wheels then
        self._kept = 0  # scans that it had kept then
        self._lost = False  # since the last step
        self._sweeps: dict[int, Sweep] = {}  # by step, frame of the robot
        self._grid = GridMap(self.settings.resolution)
        self._drawn = np.empty((0, 3))  # the poses of the sweeps that are in it

    def add(self, scan: Scan) -> Estimate:
        if not scan.stamp > self._stamp:
            return self._late(scan)
        self._stamp = scan.stamp
        points = scan.points(self.settings.max_range)
        usable = points if len(points) >= FEWEST_POINTS else None
        found = self._odometry.add(scan, usable)
        covariance = found.covariance if found else UNCERTAIN
        self._lost |= found is None
        self._step(usable, covariance)
        pose, since = self._filter.poses[self._filter.best], self._since()
        self._history.append(scan.stamp, len(self._filter.paths) - 1, since)
        return Estimate(scan.stamp, Pose(*pose.tolist()) @ since, covariance, found is not None)

    def grid(self) -> OccupancyGrid:
        poses = self._filter.paths.of(self._filter.best)[list(self._sweeps)]
        if not np.array_equal(poses[: len(self._drawn)], self._drawn):
            self._grid, self._drawn = GridMap(self.settings.resolution), np.empty((0, 3))
        sweeps = list(self._sweeps.values())
        for i in range(len(self._drawn), len(poses)):
            pose = Pose(*poses[i].tolist())
            self._grid.insert(pose.transform(sweeps[i].sensor), pose.transform(sweeps[i].points.astype(np.float64)))
        self._drawn = poses
        return self._grid.render()

    def trajectory(self) -> NDArray[np.float64]:
        return self._history.trajectory(self._filter.paths.of(self._filter.best))

    def relocate(self, pose: Pose) -> None:
        """The robot was carried to a pose (map frame) while nothing was recorded."""
        self._filter.relocate(pose)
        self._odometry = LaserOdometry(self.settings.max_range)
        self._then, self._rolled, self._kept, self._lost = None, ORIGIN, 0, False

    def state(self) -> State:
        return {
            "filter": self._filter.state(),
            "odometry": self._odometry.state(),
            "history": self._history.state(),
            "stamp": np.array([self._stamp] if math.isfinite(self._stamp) else [], np.float64),
            "then": optional(self._then),
            "rolled": optional(self._rolled),
            "seen": np.array(self._kept, np.int64),
            "lost": np.array(self._lost),
            "steps": np.array(list(self._sweeps), np.int64),
            "points": pack([sweep.points for sweep in self._sweeps.values()], np.float32),
            "grid": self._grid.state(),
            "drawn": self._drawn.copy(),
        }

    @classmethod
    def restored(cls, settings: MapperSettings, saved: Reader) -> ParticleMapper:
        """A mapper that goes on where the one that was saved was. InvalidRequest if the state is nonsense."""
        mapper = cls(settings)
        mapper._filter.restore(saved.part("filter"))
        mapper._odometry.restore(saved.part("odometry"))
        count = len(mapper._filter.paths)
        mapper._history.restore(saved.part("history"), count)
        mapper._stamp = max(saved.array("stamp", np.float64, None).tolist(), default=-math.inf)
        mapper._then, mapper._lost = saved.optional("then"), bool(saved.array("lost", np.bool_))
        mapper._rolled = saved.optional("rolled") or ORIGIN
        mapper._kept = saved.whole("seen", mapper._odometry.count + 1)
        points = saved.unpack("points", np.float32)
        steps = saved.indices("steps", count, len(points)).tolist()
        mapper._sweeps = {step: Sweep(np.zeros((1, 2)), piece) for step, piece in zip(steps, points, strict=True)}
        mapper._grid.restore(saved.part("grid"))
        mapper._drawn = saved.array("drawn", np.float64, None, 3)
        if len(mapper._drawn) > len(steps):
            raise saved.wrong("drawn", "has more poses than there are scans")
        return mapper

    def _late(self, scan: Scan) -> Estimate:
        pose = ORIGIN
        if len(self._history):
            step, since = self._history.at(scan.stamp)
            pose = Pose(*self._filter.paths.of(self._filter.best)[step].tolist()) @ since
        return Estimate(scan.stamp, pose, UNCERTAIN, matched=False, taken=False)

    def _since(self) -> Pose:
        """The motion since the last step."""
        return self._then.to(self._odometry.pose) if self._then else ORIGIN

    def _step(self, points: Points | None, covariance: NDArray[np.float64]) -> None:
        """A step of the filter, if the robot has moved enough for one."""
        motion, rolled = self._since(), self._rolled.to(self._odometry.rolled)
        if self._then is not None and not motion.moved(MOVE, TURN) and not rolled.moved(MOVE, TURN):
            return
        doubted = math.dist(motion[:2], rolled[:2]) > max(DOUBT, DOUBT_SHARE * math.hypot(*rolled[:2]))
        since = self._odometry.count if doubted else self._kept  # what was seen on a doubtful way is not believed
        seen = None if points is None else np.concatenate([points, self._odometry.seen(since)])
        if self._then is None:
            self._filter.paths.append(self._filter.poses)
        else:
            self._filter.move(motion, self._spread(covariance), seen, rolled if doubted else None)
        if points is not None and seen is not None:
            self._filter.learn(seen)
            self._keep(points)
        self._then, self._rolled = self._odometry.pose, self._odometry.rolled
        self._kept, self._lost = self._odometry.count, False
        self._filter.resample()

    def _spread(self, covariance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Covariance of the motion in the frame of the robot, from that of the last match in the odometry's frame."""
        if self._lost:
            return LOST
        c, s = math.cos(self._odometry.pose.theta), math.sin(self._odometry.pose.theta)
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        known = np.linalg.inv(DEPENDENT * turn @ covariance @ turn.T) + np.linalg.inv(LOST)
        return SPREAD + np.asarray(np.linalg.inv(known), np.float64)

    def _keep(self, points: Points) -> None:
        """Keep the scan for the grid, unless one was kept near by that looks the same way."""
        best, step = self._filter.paths.of(self._filter.best), len(self._filter.paths) - 1
        kept = best[list(self._sweeps)]
        near = np.hypot(*(kept[:, :2] - best[step, :2]).T) < DRAW_MOVE
        turn = np.abs((kept[:, 2] - best[step, 2] + np.pi) % (2 * np.pi) - np.pi) < DRAW_TURN
        if not (near & turn).any():
            self._sweeps[step] = Sweep(np.zeros((1, 2)), points.astype(np.float32))
