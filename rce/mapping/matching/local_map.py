"""Local map: the walls around the robot, with which scans are matched."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from rce.mapping.geometry import Points, Pose
from rce.mapping.grid import GridMap, OccupancyGrid
from rce.mapping.matching.fields import Field, square_around
from rce.mapping.matching.scan_matching import Match, Window, match
from rce.mapping.matching.wide_search import Candidate, search_wide
from rce.mapping.state import Reader, State, optional


@dataclass(frozen=True, slots=True)
class LocalMapSettings:
    """Settings of a local map.

    Attributes:
        resolution: Metres per cell of the field.
        way: Metres driven; places closer than this along the way agree with each other, since little drift comes
            between.
        radius: Metres from the robot to the places whose points are in the map.
        max_distance: Metres from the robot to the edge of the map at most. Further off, the points of a laser are too
            sparse to be matched.
        free_resolution: Metres per cell of the free space.
        margin: Metres that the robot may drive before the map is rebuilt around it.
        near: Window of the usual search.
        far: Window of the search if the usual one finds nothing good.
        min_score: Score below which the far window is searched.
    """

    resolution: float = 0.05
    way: float = 20.0
    radius: float = 15.0
    max_distance: float = 40.0
    free_resolution: float = 0.1
    margin: float = 4.0
    near: Window = dataclasses.field(default_factory=lambda: Window(0.5, math.radians(30)))
    far: Window = dataclasses.field(default_factory=lambda: Window(1.5, math.radians(60)))
    min_score: float = 0.65


SETTINGS = LocalMapSettings()


class LocalMap:
    """Walls around the robot, from places that agree with each other.

    Its size is bounded, and so is the cost of a scan.

    Attributes:
        places: Numbers of the places whose points are in the map.
    """

    def __init__(self, around: Callable[[Pose], Iterable[tuple[int, Points, Points]]], max_range: float) -> None:
        """Make an empty map.

        Args:
            around: Returns the scans near a pose: for each the number of its place, where the laser was (1, 2), and its
                points (n, 2), metres, map frame.
            max_range: Metres; range of the laser.
        """
        self._around = around
        self._half = min(max_range, SETTINGS.max_distance) + SETTINGS.margin
        self._centre = Pose(math.inf, 0.0, 0.0)
        self._field: Field | None = None
        self.places: set[int] = set()

    def recentre(self, pose: Pose) -> None:
        """Rebuild the map if the robot is too far from its centre."""
        if self._field is None or math.dist(pose[:2], self._centre[:2]) > SETTINGS.margin:
            self.rebuild(pose)

    def rebuild(self, pose: Pose) -> None:
        """Rebuild the map around a pose, for instance after an optimisation has moved places."""
        self._centre = pose
        self._field = square_around(pose, self._half, SETTINGS.resolution)
        self.places = set()
        for place, _, points in self._around(pose):
            self.places.add(place)
            self._field.add(points)

    def state(self) -> State:
        """Return the map as arrays to save; empty before it is first built."""
        if self._field is None:
            return {}
        return {
            "centre": optional(self._centre),
            "places": np.array(sorted(self.places), np.int64),
            "likelihood": self._field.likelihood.copy(),
            "tiles": self._field.tiles.copy(),
        }

    def restore(self, saved: Reader, places: int) -> None:
        """Replace the map by a saved one.

        Args:
            saved: The saved arrays.
            places: Number of places that exist.

        Raises:
            InvalidRequest: The saved arrays are not a local map.
        """
        centre = saved.optional("centre")
        if centre is None:
            raise saved.invalid("centre", "is missing")
        field = square_around(centre, self._half, SETTINGS.resolution)
        field.likelihood = saved.array("likelihood", np.uint8, *field.likelihood.shape)
        field.tiles = saved.array("tiles", np.float32, *field.tiles.shape)
        self._centre, self._field = centre, field
        self.places = set(saved.indices("places", places, None).tolist())

    def add(self, place: int, points: Points) -> None:
        """Add the points (n, 2), metres, map frame, of a scan that belongs to a place."""
        self.places.add(place)
        if self._field is not None:
            self._field.add(points)

    def contains(self, pose: Pose) -> bool:
        """Return whether a pose lies in the map."""
        return self._field is not None and self._field.contains(pose)

    def candidates(
        self,
        points: Points,
        predictions: list[Pose],
        spread: float,
        step_cost: Callable[[Pose], float] = lambda pose: 0.0,
    ) -> list[Candidate]:
        """Return the places where a scan fits, the best first; several only if nothing predicts the motion.

        Args:
            points: (n, 2), metres, frame of the robot.
            predictions: Poses in the map frame, the most trusted first.
            spread: Metres by which the first prediction is usually off; infinite if the motion is unknown.
            step_cost: Returns the penalty of a pose if the motion is unknown; see `search_wide`.

        Returns:
            The places; none while the map is empty, no prediction lies in it, or the scan contradicts it everywhere.
        """
        field = self._field
        inside = [prediction for prediction in predictions if field is not None and field.contains(prediction)]
        if field is None or not inside:
            return []
        if math.isinf(spread):
            return search_wide(field, self._free_space(), points, inside, step_cost)
        found = match(field, points, inside, SETTINGS.near, spread)
        if found.score < SETTINGS.min_score:
            far = match(field, points, inside, SETTINGS.far)
            found = max(found, far, key=lambda candidate: candidate.score)
        return [Candidate(found, found.score)]

    def match(
        self,
        points: Points,
        predictions: list[Pose],
        spread: float,
        step_cost: Callable[[Pose], float] = lambda pose: 0.0,
    ) -> Match | None:
        """Return the best of the `candidates`, or None if there are none."""
        found = self.candidates(points, predictions, spread, step_cost)
        return found[0].match if found else None

    def copy(self, around: Callable[[Pose], Iterable[tuple[int, Points, Points]]]) -> LocalMap:
        """Return a map that has the same walls, and takes further ones by itself from `around`."""
        other = copy.copy(self)
        other._around, other._field, other.places = around, copy.deepcopy(self._field), set(self.places)
        return other

    def _free_space(self) -> OccupancyGrid:
        """Return the free space around the robot. It is rendered for each scan that needs it: these are few."""
        grid = GridMap(SETTINGS.free_resolution)
        for _, sensor, points in self._around(self._centre):
            grid.insert(sensor, points)
        return grid.render()
