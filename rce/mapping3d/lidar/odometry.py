"""Front end of a lidar: the pose of each sweep, and key frames made of the sweeps since the one before.

Indoors there are planes, and a sweep is laid on those of the last ones, see `registration`. Where they do not suffice,
the pose is that of KISS-ICP by the library of its authors (Vizzo et al., KISS-ICP: In Defense of Point-to-Point ICP,
2023), whose parts are driven here. Alone it falls behind in corridors: the rings that a spinning lidar draws on floor
and ceiling move with it and pull a registration of points to points back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from kiss_icp.config import KISSConfig
from kiss_icp.kiss_icp import KissICP
from kiss_icp.voxelization import voxel_down_sample
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rce.mapping.clouds import Sweep
from rce.mapping3d.frames import CloudKeyFrame
from rce.mapping3d.lidar.registration import Registration, Surface, information_of, measured, register
from rce.mapping3d.odometry.tracker import Tracked
from rce.mapping3d.poses import Floats, Pose, angle, distance, interpolate, inverse, rigid, transform


@dataclass(frozen=True, slots=True)
class LidarSettings:
    """Settings of the front end of a lidar.

    Attributes:
        nearest: Points nearer than this belong to the robot, metres.
        furthest: Points further away are not used, metres.
        voxel: Edge of the voxels of the local map, metres, as a share of the median range of the first sweep.
        voxels: Bounds of that edge, metres.
        fine: Spacing of the points of a key frame, as a share of that edge.
        steps: Most steps of KISS-ICP.
        recent: Sweeps whose planes are used.
        renewal: Metres and radians after which their planes are found anew.
        reach: As in `RegistrationSettings`, for registrations to planes.
        good: Share of points on planes with which a registration needs no other.
        better: By how much that share must be larger after KISS-ICP: in a direction that planes leave open, the
            predicted motion is better than what points say.
        trusted: With a smaller share, planes do not count.
        distance: Metres from the key frame at which the next one is made.
        angle: Radians, likewise.
        overlap: Share of the points that have a neighbour in the recent sweeps, likewise.
        least_overlap: With less of them track is lost.
        jump: Metres and radians from the predicted pose, beyond which track is lost.
        least_points: A sweep with fewer is no sweep.
        patience: Sweeps after which a lost front end starts anew.
        settling: Sweeps at the beginning whose motion is not predicted yet.
    """

    nearest: float = 0.3
    furthest: float = 80.0
    voxel: float = 0.12
    voxels: tuple[float, float] = (0.3, 1.0)
    fine: float = 0.4
    steps: int = 20
    recent: int = 40
    renewal: tuple[float, float] = (0.3, math.radians(8.0))
    reach: tuple[float, ...] = (0.6, 0.3)
    good: float = 0.8
    better: float = 0.05
    trusted: float = 0.3
    distance: float = 0.75
    angle: float = math.radians(25.0)
    overlap: float = 0.6
    least_overlap: float = 0.25
    jump: tuple[float, float] = (1.0, math.radians(30.0))
    least_points: int = 200
    patience: int = 10
    settling: int = 3


class LidarTracker:
    """Front end of one robot with a lidar.

    Attributes:
        lost: True while the pose is unknown.
    """

    def __init__(self, robot: int = 0, settings: LidarSettings | None = None) -> None:
        """Begin without a key frame.

        Args:
            robot: Number that key frames get.
            settings: Settings, None for the default.
        """
        self.lost = False
        self._settings = settings or LidarSettings()
        self._robot = robot
        self._count = 0
        self._missed = 0
        self._odometry: _Odometry | None = None
        self._key_pose = np.eye(4)  # of the last key frame in the frame of the odometry
        self._waiting: list[tuple[Pose, Floats]] = []  # poses and points of the sweeps since it

    def add(self, sweep: Sweep) -> Tracked:
        """Return the pose of the next sweep: that of the lidar at its stamp, when the sweep began."""
        settings = self._settings
        ranges = np.linalg.norm(sweep.points, axis=1)
        used = (ranges > settings.nearest) & (ranges < settings.furthest)
        if int(used.sum()) < settings.least_points:
            return self._blind(sweep.stamp)
        if self._odometry is None:
            self._odometry = _Odometry(float(np.median(ranges[used])), settings)
        step = self._odometry.add(sweep.stamp, sweep.points[used].astype(np.float64), sweep.times[used])
        if not self._waiting and self._odometry.sweeps == 1:
            return self._begin(sweep.stamp, step)
        relative = inverse(self._key_pose) @ step.begin
        if step.found.overlap < settings.least_overlap or step.jumped:
            return self._miss(sweep.stamp, relative)
        self._missed, self.lost = 0, False
        self._waiting.append((step.end, step.points))
        moved = max(distance(relative) / settings.distance, angle(relative) / settings.angle)
        if moved < 1.0 and step.found.overlap > settings.overlap:
            return Tracked(sweep.stamp, self._count - 1, relative, step.found.information)
        key = self._make_key(sweep.stamp, step.begin)
        return Tracked(sweep.stamp, key.index - 1, relative, step.found.information, key=key)

    def _blind(self, stamp: float) -> Tracked:
        """Answer a sweep without enough points."""
        if self._odometry is None:
            return Tracked(stamp, self._count - 1, np.eye(4), np.zeros((6, 6)), lost=True)
        return self._miss(stamp, inverse(self._key_pose) @ self._odometry.pose)

    def _miss(self, stamp: float, relative: Pose) -> Tracked:
        """Answer a sweep whose pose was not found; after some of them begin anew with the next one."""
        self._missed += 1
        self.lost = True
        if self._missed >= self._settings.patience:
            self._odometry, self._waiting, self._missed = None, [], 0
        return Tracked(stamp, self._count - 1, relative, np.zeros((6, 6)), lost=True)

    def _begin(self, stamp: float, step: _Step) -> Tracked:
        """Answer the first sweep, which becomes a key frame without relation to those before."""
        self._waiting, before = [(step.end, step.points)], self._count - 1
        self.lost = False
        key = self._make_key(stamp, step.begin)
        return Tracked(stamp, before, np.eye(4), np.zeros((6, 6)), key=key, linked=False)

    def _make_key(self, stamp: float, pose: Pose) -> CloudKeyFrame:
        """Return a key frame of the sweeps since the last one, in the frame of the lidar at the newest stamp."""
        assert self._odometry is not None
        back = inverse(pose)
        together = np.concatenate([transform(back @ each, points) for each, points in self._waiting])
        points = np.asarray(voxel_down_sample(together, self._odometry.spacing), np.float32)
        key = CloudKeyFrame(self._robot, self._count, stamp, points)
        self._count += 1
        # The next key frame has the newest sweep too, so that none is too thin.
        self._key_pose, self._waiting = pose, self._waiting[-1:]
        return key


@dataclass(frozen=True, slots=True)
class _Step:
    """Result of the odometry for a sweep.

    Attributes:
        begin: (4, 4) pose when the sweep began.
        end: (4, 4) pose when it ended.
        points: (n, 3) thinned points, frame of the lidar at the end.
        found: How well they fit the sweeps before.
        jumped: Whether the pose is too far from the predicted one.
    """

    begin: Pose
    end: Pose
    points: Floats
    found: Registration
    jumped: bool


def _score(found: Registration) -> float:
    """Return the share of points that lie on planes of the other cloud."""
    return found.fit * found.overlap


class _Odometry:
    """Registration to the planes of the last sweeps, and KISS-ICP.

    Attributes:
        spacing: Of thinned points, metres.
        pose: (4, 4) pose at the end of the last sweep.
        sweeps: Number of sweeps so far.
    """

    def __init__(self, median: float, settings: LidarSettings) -> None:
        """Begin with voxels that fit a sweep of this median range, metres."""
        low, high = settings.voxels
        config = KISSConfig()
        config.data.max_range, config.data.min_range = settings.furthest, settings.nearest
        config.data.deskew = False
        config.mapping.voxel_size = min(max(settings.voxel * median, low), high)
        config.registration.max_num_threads, config.registration.max_num_iterations = 1, settings.steps
        self.spacing = settings.fine * config.mapping.voxel_size
        self.pose, self.sweeps = np.eye(4), 0
        self._settings = settings
        self._kiss: Any = KissICP(config)
        self._delta = np.eye(4)  # motion from the end of one sweep to the end of the next
        self._stamp = 0.0  # of the sweep before
        self._recent: list[tuple[Pose, Floats]] = []
        self._surface: tuple[Pose, Surface] | None = None  # the planes of recent sweeps, and the frame that they are in

    def add(self, stamp: float, points: Floats, times: NDArray[np.float64]) -> _Step:
        """Return where the lidar was during a sweep (n, 3), frame of the lidar, with times (n,)."""
        # Motion compensation: the last motion goes on. Points get the frame of the end of the sweep; with that of the
        # beginning an error of the motion would grow from sweep to sweep.
        period = stamp - self._stamp
        span = float(times.max()) / period if self.sweeps and 0.0 < period < 1.0 else 0.0
        points = self._deskewed(points, times, period) if span else points
        predicted = self.pose @ self._delta
        # Registration to the planes of the last sweeps, and where they do not suffice, to the points of the local map
        # and to the planes again.
        thin = np.asarray(voxel_down_sample(points, self.spacing))
        pose, found = self._registered(points, thin, predicted)
        off = inverse(predicted) @ pose
        self._kiss.adaptive_threshold.update_model_deviation(off)
        self._kiss.local_map.update(self._kiss.voxelize(points)[1], pose)
        before, self.pose = self.pose, pose
        self._delta = rigid(inverse(before) @ pose) if self.sweeps else np.eye(4)
        self.sweeps, self._stamp = self.sweeps + 1, stamp
        self._remember(pose, thin)
        far, turned = self._settings.jump
        jumped = self.sweeps > self._settings.settling and (distance(off) > far or angle(off) > turned)
        begin = interpolate(pose, before, min(span, 1.0))
        return _Step(begin, pose, thin, found, jumped)

    def _deskewed(self, points: Floats, times: NDArray[np.float64], period: float) -> Floats:
        """Return points (n, 3) in the frame of the lidar at the end of the sweep, if the motion stays what it was."""
        shares = (times - times.max()) / period
        turns = Rotation.from_rotvec(shares[:, None] * Rotation.from_matrix(self._delta[:3, :3]).as_rotvec())
        return np.asarray(turns.apply(points) + shares[:, None] * self._delta[:3, 3], np.float64)

    def _registered(self, points: Floats, thin: Floats, predicted: Pose) -> tuple[Pose, Registration]:
        """Return the pose of a sweep (n, 3), of which `thin` (m, 3) is a part, and how well it fits."""
        source = Surface(thin)
        if self._surface is None:
            information = information_of(source.points, source.normals)
            return predicted, Registration(predicted, information, 1.0, 1.0)
        frame, target = self._surface
        back = inverse(frame)
        by_planes = register(target, source, back @ predicted, self._settings.reach)
        if _score(by_planes) > self._settings.good:
            return rigid(frame @ by_planes.pose), by_planes
        by_points = self._by_points(points, predicted)
        refined = register(target, source, back @ by_points, self._settings.reach)
        best = refined if _score(refined) > _score(by_planes) + self._settings.better else by_planes
        if _score(best) > self._settings.trusted:
            return rigid(frame @ best.pose), best
        return rigid(by_points), measured(target, source, back @ by_points)

    def _by_points(self, points: Floats, predicted: Pose) -> Pose:
        """Return the pose of KISS-ICP, with a threshold that adapts to the errors of the prediction."""
        source, _ = self._kiss.voxelize(points)
        sigma = self._kiss.adaptive_threshold.get_threshold()
        align = self._kiss.registration.align_points_to_map
        return np.asarray(align(source, self._kiss.local_map, predicted, 3 * sigma, sigma), np.float64)

    def _remember(self, pose: Pose, points: Floats) -> None:
        """Add a sweep to the recent ones, and find their planes anew when the lidar has moved."""
        self._recent = [*self._recent, (pose, points)][-self._settings.recent :]
        far, turned = self._settings.renewal
        if self._surface is not None and self.sweeps > self._settings.settling:
            way = inverse(self._surface[0]) @ pose
            if distance(way) < far and angle(way) < turned:
                return
        back = inverse(pose)
        together = np.concatenate([transform(back @ each, some) for each, some in self._recent])
        self._surface = pose, Surface(np.asarray(voxel_down_sample(together, self.spacing)))
