"""A simulated building, as lidars of two patterns see it from a robot that moves while they measure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rce.mapping.clouds import Sweep
from rce.mapping.matching.kernels import compiled
from rce.mapping3d.files.trajectories import Stamped
from rce.mapping3d.poses import Floats, interpolate, make_pose

HEIGHT, WALL = 2.8, 0.2  # metres
START = 2.0  # seconds in which a robot reaches its speed
LENGTH, WIDTH = 20.0, 14.0  # metres of the building: a corridor around four rooms
# Walls in the plan: (4,) lower and upper corner, metres. Gaps are doors.
WALLS = (
    (-WALL, -WALL, LENGTH + WALL, 0.0),
    (-WALL, WIDTH, LENGTH + WALL, WIDTH + WALL),
    (-WALL, 0.0, 0.0, WIDTH),
    (LENGTH, 0.0, LENGTH + WALL, WIDTH),
    (2.4, 2.4, 5.5, 2.6),
    (6.7, 2.4, 13.0, 2.6),
    (14.2, 2.4, 17.6, 2.6),
    (2.4, 11.4, 8.0, 11.6),
    (9.2, 11.4, 15.0, 11.6),
    (16.2, 11.4, 17.6, 11.6),
    (2.4, 2.6, 2.6, 11.4),
    (17.4, 2.6, 17.6, 6.0),
    (17.4, 7.2, 17.6, 11.4),
    (9.9, 2.6, 10.1, 11.4),
    (2.6, 6.9, 9.9, 7.1),
    (10.1, 8.0, 14.0, 8.2),
    (15.2, 8.0, 17.4, 8.2),
)
# (6,) lower and upper corner, metres.
FURNITURE = (
    (0.0, 4.0, 0.0, 0.4, 5.5, 2.0),  # in the corridor
    (0.0, 9.5, 0.0, 0.6, 10.3, 1.1),
    (7.0, 0.0, 0.0, 8.8, 0.45, 1.9),
    (15.5, 0.0, 0.0, 16.0, 0.5, 0.8),
    (19.5, 3.0, 0.0, 20.0, 4.0, 2.1),
    (19.3, 9.0, 0.0, 20.0, 11.0, 0.9),
    (11.0, 13.6, 0.0, 13.0, 14.0, 1.2),
    (4.0, 13.3, 0.0, 4.8, 14.0, 2.0),
    (3.2, 4.0, 0.70, 5.0, 5.0, 0.76),  # in the rooms
    (7.5, 5.5, 0.0, 9.0, 6.9, 1.0),
    (3.0, 8.5, 0.0, 3.5, 10.5, 2.0),
    (6.0, 8.6, 0.70, 8.0, 9.6, 0.76),
    (12.0, 4.5, 0.0, 13.0, 5.5, 0.9),
    (15.8, 3.2, 0.0, 17.2, 3.8, 1.8),
    (11.0, 9.5, 0.70, 13.0, 10.4, 0.76),
    (16.0, 10.0, 0.0, 17.2, 11.2, 1.4),
)
BOXES = np.array(
    [
        *((x, y, 0.0, right, back, HEIGHT) for x, y, right, back in WALLS),
        *FURNITURE,
        (-1.0, -1.0, -0.3, LENGTH + 1.0, WIDTH + 1.0, 0.0),
        (-1.0, -1.0, HEIGHT, LENGTH + 1.0, WIDTH + 1.0, HEIGHT + 0.3),
    ]
)
# Corners of ways through the building, metres.
ROUND = ((1.2, 1.2), (18.8, 1.2), (18.8, 12.8), (1.2, 12.8))
ROOMS = ((1.2, 1.2), (6.1, 1.2), (6.1, 5.2), (4.5, 6.0), (6.1, 5.2), (6.1, 1.2), (13.6, 1.2), (13.6, 6.5), (13.6, 1.2))


@dataclass(frozen=True, slots=True)
class Pattern:
    """Directions and times of the beams of a sweep.

    Attributes:
        name: Name.
        directions: (sweeps, n, 3) unit vectors, frame of the lidar; sweeps repeat in this order.
        times: (n,) seconds since the first point of a sweep.
        period: Seconds from sweep to sweep.
    """

    name: str
    directions: NDArray[np.float64]
    times: NDArray[np.float64]
    period: float


def spinning(beams: int = 16, columns: int = 360, lowest: float = -25.0, highest: float = 15.0) -> Pattern:
    """Return the pattern of a lidar that turns: a column of beams at once; angles in degrees."""
    elevation = np.radians(np.linspace(lowest, highest, beams))
    azimuth = -2 * math.pi * np.arange(columns) / columns
    around, up = (each.ravel() for each in np.meshgrid(azimuth, elevation, indexing="ij"))
    period = 0.1
    return Pattern(
        f"spinning-{beams}", _unit(around, up)[None], np.repeat(np.arange(columns), beams) / columns * 0.1, period
    )


def solid_state(points: int = 6000, sweeps: int = 16, width: float = 100.0, height: float = 70.0) -> Pattern:
    """Return the pattern of a lidar with rotating prisms: rosettes that do not repeat for some time; degrees."""
    period = 0.1
    seconds = np.arange(sweeps * points) * period / points
    # Two prisms that turn at different speeds draw a rosette.
    first, second = 2 * math.pi * 110.3 * seconds, -2 * math.pi * 71.7 * seconds
    across = 0.5 * (np.cos(first) + np.cos(second))
    along = 0.5 * (np.sin(first) + np.sin(second))
    directions = _unit(np.radians(width / 2) * across, np.radians(height / 2) * along)
    return Pattern("solid-state", directions.reshape(sweeps, points, 3), np.arange(points) * period / points, period)


@dataclass(frozen=True, slots=True)
class SimulatedSweeps:
    """Sweeps of a lidar that is moved through the building, with ground truth: a `LidarRecording`.

    Attributes:
        name: Name.
        way: Poses of the lidar at the beginnings of sweeps, and one after the last; z of the map up.
        pattern: What the lidar does.
        noise: Standard deviation of ranges, metres.
        furthest: Metres.
        missing: Share of the beams without return.
        seed: Of the noise.
    """

    name: str
    way: tuple[Stamped, ...]
    pattern: Pattern
    noise: float = 0.015
    furthest: float = 30.0
    missing: float = 0.02
    seed: int = 0

    @property
    def frames(self) -> int:
        """Number of sweeps."""
        return len(self.way) - 1

    def __iter__(self) -> Iterator[Sweep]:
        """Yield the sweeps."""
        random = np.random.default_rng(self.seed)
        for number in range(self.frames):
            yield self._sweep(number, random)

    def _sweep(self, number: int, random: np.random.Generator) -> Sweep:
        pattern = self.pattern
        (stamp, begin), (_, end) = self.way[number], self.way[number + 1]
        directions = pattern.directions[number % len(pattern.directions)]
        origins, turned = _moving(begin, end, pattern.times / pattern.period, directions)
        ranges = np.empty(len(directions))
        cast(BOXES, origins, turned, ranges)
        ranges += random.normal(0.0, self.noise, len(ranges))
        seen = (ranges > 0.3) & (ranges < self.furthest) & (random.random(len(ranges)) > self.missing)
        points = (directions[seen] * ranges[seen, None]).astype(np.float32)
        return Sweep(stamp, points, pattern.times[seen])


def patrol(
    corners: Sequence[tuple[float, float]], seconds: float, speed: float = 0.8, height: float = 0.9, begin: float = 0.0
) -> tuple[Stamped, ...]:
    """Return the way of a robot from corner to corner and on from the first one, ten poses a second.

    It starts from rest, turns before it reaches a corner, and shakes a little.

    Args:
        corners: Metres.
        seconds: Length.
        speed: Metres a second.
        height: Of the lidar, metres.
        begin: Metres of the way at which it begins.
    """
    closed = np.array([*corners, corners[0]])
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])

    def place(metres: float) -> Floats:
        at = metres % lengths[-1]
        return np.array([np.interp(at, lengths, closed[:, 0]), np.interp(at, lengths, closed[:, 1])])

    way = []
    for number in range(round(seconds * 10) + 1):
        stamp = number / 10
        metres = begin + speed * (stamp**2 / (2 * START) if stamp < START else stamp - START / 2)
        # The mean over some way rounds the corners.
        x, y = np.mean([place(metres + ahead) for ahead in np.linspace(-0.6, 0.6, 13)], axis=0)
        ahead = np.mean([place(metres + each) for each in np.linspace(0.2, 2.2, 21)], axis=0)
        heading = math.atan2(ahead[1] - y, ahead[0] - x)
        shaking = (0.012 * math.sin(5.1 * stamp), 0.015 * math.sin(3.7 * stamp))
        turn = Rotation.from_euler("ZYX", (heading, *shaking)).as_matrix()
        way.append((stamp, make_pose(turn, (x, y, height + 0.01 * math.sin(6.3 * stamp)))))
    return tuple(way)


def _unit(around: Floats, up: Floats) -> Floats:
    """Return unit vectors (n, 3) of angles from x to y and upwards, radians."""
    return np.stack([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)], axis=-1)


def _moving(begin: Floats, end: Floats, shares: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """Return where beams (n, 3) of a moving lidar begin and point, frame of the map, at shares of the way."""
    steps = 32  # poses on the way: a spinning lidar turns 11 degrees meanwhile
    poses = np.stack([interpolate(begin, end, (step + 0.5) / steps) for step in range(steps)])
    chosen = poses[np.clip((shares * steps).astype(np.int64), 0, steps - 1)]
    turned: Floats = np.einsum("nij,nj->ni", chosen[:, :3, :3], directions)
    return np.ascontiguousarray(chosen[:, :3, 3]), np.ascontiguousarray(turned)


@compiled("void(float64[:,::1], float64[:,::1], float64[:,::1], float64[::1])")
def cast(
    boxes: NDArray[np.float64],
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    ranges: NDArray[np.float64],
) -> None:
    """Cast rays to the nearest box (Kay and Kajiya, Ray Tracing Complex Scenes, 1986).

    Args:
        boxes: (m, 6) lower and upper corners, metres.
        origins: (n, 3) where rays begin, metres, outside all boxes.
        directions: (n, 3) unit vectors.
        ranges: (n,) metres, set; infinity where nothing is hit.
    """
    for i in range(origins.shape[0]):
        nearest = np.inf
        for number in range(boxes.shape[0]):
            enter, leave = 0.0, np.inf
            for k in range(3):
                d = directions[i, k]
                if abs(d) < 1e-12:
                    if not boxes[number, k] <= origins[i, k] <= boxes[number, k + 3]:
                        enter = np.inf
                    continue
                first = (boxes[number, k] - origins[i, k]) / d
                second = (boxes[number, k + 3] - origins[i, k]) / d
                enter = max(enter, min(first, second))
                leave = min(leave, max(first, second))
            if enter <= leave and 0.0 < enter < nearest:
                nearest = enter
        ranges[i] = nearest
