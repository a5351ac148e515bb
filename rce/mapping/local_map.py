"""The part of the map around the robot, with which scans are matched."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from rce.mapping.fields import Field, square_around
from rce.mapping.geometry import Points, Pose
from rce.mapping.grid import GridMap, OccupancyGrid
from rce.mapping.matching import Match, Window, match
from rce.mapping.state import Reader, State, optional
from rce.mapping.wide_search import match_wide

RESOLUTION = 0.05
WAY = 20.0  # metres; places nearer than this, as the robot went, agree with each other
AROUND = 15.0  # metres from the robot to the places whose points are in it
FARTHEST = 40.0  # metres from the robot; beyond, the points of a laser are too sparse to match
FREE_RESOLUTION = 0.1
MARGIN = 4.0  # metres that the robot may go before it is made anew
NEAR, FAR = Window(0.5, math.radians(30)), Window(1.5, math.radians(60))
DOUBT = 0.65  # a score under this makes the search go far


class LocalMap:
    """Walls around the robot, so far as they agree with each other. Its size is bounded, and so is the cost of a scan.

    It asks for the walls by `around`: the scans near a pose, each with the number of its place, where the laser was
    (1, 2), and its points (n, 2), metres, map frame.
    """

    def __init__(self, around: Callable[[Pose], Iterable[tuple[int, Points, Points]]], max_range: float) -> None:
        self._around = around
        self._half = min(max_range, FARTHEST) + MARGIN
        self._centre = Pose(math.inf, 0.0, 0.0)
        self._field: Field | None = None
        self.places: set[int] = set()  # those whose points are in it

    def follow(self, pose: Pose) -> None:
        """Make it anew around a robot that went too far from where it was made."""
        if self._field is None or math.dist(pose[:2], self._centre[:2]) > MARGIN:
            self.renew(pose)

    def renew(self, pose: Pose) -> None:
        """Make it anew, since the walls have moved."""
        self._centre = pose
        self._field = square_around(pose, self._half, RESOLUTION)
        self.places = set()
        for place, _, points in self._around(pose):
            self.places.add(place)
            self._field.add(points)

    def state(self) -> State:
        if self._field is None:
            return {}
        return {
            "centre": optional(self._centre),
            "places": np.array(sorted(self.places), np.int64),
            "likelihood": self._field.likelihood.copy(),
            "tiles": self._field.tiles.copy(),
        }

    def restore(self, saved: Reader, places: int) -> None:
        """`places`: how many there are."""
        centre = saved.optional("centre")
        if centre is None:
            raise saved.wrong("centre", "is missing")
        field = square_around(centre, self._half, RESOLUTION)
        field.likelihood = saved.array("likelihood", np.uint8, *field.likelihood.shape)
        field.tiles = saved.array("tiles", np.float32, *field.tiles.shape)
        self._centre, self._field = centre, field
        self.places = set(saved.indices("places", places, None).tolist())

    def add(self, place: int, points: Points) -> None:
        """Enter the points (n, 2), metres, map frame, of a scan that belongs to a new place."""
        self.places.add(place)
        if self._field is not None:
            self._field.add(points)

    def match(self, points: Points, predictions: list[Pose], spread: float) -> Match | None:
        """Where the robot is that sees the points (n, 2), metres, its frame. `spread`: metres by which the
        first prediction is off, if things are as usual; infinite where nothing is known about how it moved.

        None while the map is empty, or has no prediction in it.
        """
        if self._field is None:
            return None
        low, high = self._field.bounds
        inside = [p for p in predictions if (np.array(p[:2]) > low).all() and (np.array(p[:2]) < high).all()]
        if not inside:
            return None
        if math.isinf(spread):
            return match_wide(self._field, self._free(), points, inside)
        found = match(self._field, points, inside, NEAR, spread)
        if found.score >= DOUBT:
            return found
        far = match(self._field, points, inside, FAR)
        return max(found, far, key=lambda candidate: candidate.score)

    def _free(self) -> OccupancyGrid:
        """What is free around the robot; made for each scan that needs it, since these are rare."""
        grid = GridMap(FREE_RESOLUTION)
        for _, sensor, points in self._around(self._centre):
            grid.insert(sensor, points)
        return grid.render()
