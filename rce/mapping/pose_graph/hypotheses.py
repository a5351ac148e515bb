"""Mapper `graph`: graph SLAM that follows several paths while the scans do not tell which of them is right."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.mapper import Estimate, MapperSettings
from rce.mapping.matching import wide_search
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.scans import Scan
from rce.mapping.state import Reader, State


@dataclass(frozen=True, slots=True)
class HypothesisSettings:
    """Settings of the hypotheses.

    Attributes:
        most: Hypotheses that are kept, at most.
        places: Places of one scan, at most, that become hypotheses.
        behind: Value by which a hypothesis has to be behind the best one to be dropped.
    """

    most: int = 4
    places: int = 3
    behind: float = 0.7


SETTINGS = HypothesisSettings()


@dataclass(slots=True)
class Hypothesis:
    """Path of the robot with its map.

    Attributes:
        mapper: The path and the map.
        value: Sum of the values of its scans (see `Candidate`).
    """

    mapper: GraphMapper
    value: float = 0.0

    def follow(self, scan: Scan) -> Iterator[tuple[Hypothesis, Estimate]]:
        """Yield a hypothesis for each place where the next scan may be, with the estimate. The last one is this one."""
        places = self.mapper.candidates(scan)[: SETTINGS.places]
        for place in places[1:]:
            copied = Hypothesis(self.mapper.copy(), self.value + place.value)
            yield copied, copied.mapper.place(scan, place)
        self.value += places[0].value if places else wide_search.SETTINGS.least
        yield self, self.mapper.place(scan, places[0] if places else None)

    def is_like(self, other: Hypothesis) -> bool:
        """Return whether the robot is at the same place."""
        motion = self.mapper.pose.to(other.mapper.pose)
        return not motion.exceeds(wide_search.SETTINGS.same, wide_search.SETTINGS.same_turn)


class HypothesisMapper:
    """Graph SLAM with multiple hypotheses (Reid, An Algorithm for Tracking Multiple Targets, 1979, section IV).

    Without odometry, and with scans that are metres apart, a scan may fit at several places. Which one was right shows
    only in later scans, so each becomes a path with a map of its own. Paths that meet are merged, and those whose scans
    fit clearly worse are dropped. With odometry or frequent scans there is one path, and nothing is copied.
    """

    def __init__(self, settings: MapperSettings | None = None) -> None:
        """Start an empty map at the origin."""
        self._hypotheses = [Hypothesis(GraphMapper(settings))]  # the best first

    @property
    def best(self) -> GraphMapper:
        """The map of the best path."""
        return self._hypotheses[0].mapper

    @property
    def settings(self) -> MapperSettings:
        """Settings of the mapper."""
        return self.best.settings

    def add(self, scan: Scan) -> Estimate:
        """Map the next scan. One that is not newer than those before is answered but not mapped.

        The pose may jump to another path, as it does when a loop closes.
        """
        followed = [each for hypothesis in self._hypotheses for each in hypothesis.follow(scan)]
        followed.sort(key=lambda each: each[0].value, reverse=True)
        self._hypotheses = _pruned(hypothesis for hypothesis, _ in followed)
        return followed[0][1]

    def grid(self) -> OccupancyGrid:
        """Return the current map."""
        return self.best.grid()

    def trajectory(self) -> NDArray[np.float64]:
        """Return (n, 4) stamp, x, y, theta of every accepted scan, map frame."""
        return self.best.trajectory()

    def relocate(self, pose: Pose) -> None:
        """Continue at a pose (map frame) to which the robot was carried while nothing was recorded."""
        del self._hypotheses[1:]
        self.best.relocate(pose)

    def state(self) -> State:
        """Return the mapper as arrays to save."""
        return {
            "values": np.array([hypothesis.value for hypothesis in self._hypotheses]),
            "paths": {str(number): each.mapper.state() for number, each in enumerate(self._hypotheses)},
        }

    @classmethod
    def restored(cls, settings: MapperSettings, saved: Reader) -> HypothesisMapper:
        """Return a mapper that continues where a saved one stopped.

        Raises:
            InvalidRequest: The saved arrays are not the state of this mapper.
        """
        values, paths = saved.array("values", np.float64, None).tolist(), saved.part("paths")
        if not 1 <= len(values) <= SETTINGS.most:
            raise saved.invalid("values", f"has {len(values)} values, not 1 to {SETTINGS.most}")
        mapper = cls(settings)
        mapper._hypotheses = [
            Hypothesis(GraphMapper.restored(settings, paths.part(str(number))), value)
            for number, value in enumerate(values)
        ]
        return mapper


def _pruned(hypotheses: Iterable[Hypothesis]) -> list[Hypothesis]:
    """Return the hypotheses to keep of those that are sorted by value, the best first."""
    kept: list[Hypothesis] = []
    for hypothesis in hypotheses:
        if kept and hypothesis.value <= kept[0].value - SETTINGS.behind:
            break
        if not any(hypothesis.is_like(other) for other in kept):
            kept.append(hypothesis)
    return kept[: SETTINGS.most]
