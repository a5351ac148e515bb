"""Hypotheses, with places that are given: which places a scan has is tested with the wide search."""

from __future__ import annotations

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.mapper import MapperSettings
from rce.mapping.matching.scan_matching import Match
from rce.mapping.matching.wide_search import Candidate
from rce.mapping.pose_graph.hypotheses import SETTINGS, HypothesisMapper
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.state import Reader, flatten
from tests.support.laser import scan_at

PRECISE = 1e-4 * np.eye(3)
Places = dict[float, float]  # metres along x from the last pose: value of the scan there


class World:
    """Robot that drives along x. Its scans are at the places that the test gives, by the position on the path."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Give places to all mappers."""
        self.mapper = HypothesisMapper()
        self._stamp = 0.0
        self._places: dict[float, Places] = {}
        monkeypatch.setattr(GraphMapper, "candidates", lambda mapper, scan: self._candidates(mapper))

    def _candidates(self, mapper: GraphMapper) -> list[Candidate]:
        here = mapper.pose.x
        places = next((each for x, each in self._places.items() if abs(x - here) < 0.01), self._places.get(np.inf, {}))
        return [Candidate(Match(Pose(here + x, 0.0, 0.0), 1.0, PRECISE), value) for x, value in places.items()]

    def scan(self, everywhere: Places | None = None, at: dict[float, Places] | None = None) -> float:
        """Add a scan, and return x of the robot."""
        self._places = at or {}
        if everywhere is not None:
            self._places[np.inf] = everywhere
        self._stamp += 1.0
        return self.mapper.add(scan_at(ORIGIN, beams=36, stamp=self._stamp)).pose.x

    @property
    def count(self) -> int:
        """Number of hypotheses."""
        return len(self.mapper.state()["values"])


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> World:
    made = World(monkeypatch)
    made.scan({})
    return made


def test_recording_with_odometry_has_one_path(simulation: Simulation) -> None:
    several, one = HypothesisMapper(), GraphMapper()
    for scan in simulation.records[:60]:
        assert several.add(scan).pose == one.add(scan).pose
    assert len(several.state()["values"]) == 1
    np.testing.assert_array_equal(several.grid().cells, one.grid().cells)


def test_later_scans_decide_between_places(world: World) -> None:
    assert world.scan({1.0: 0.6, 2.0: 0.5}) == 1.0
    assert world.count == 2
    assert world.scan(at={1.0: {1.0: 0.4}, 2.0: {1.0: 0.7}}) == 3.0, "the second place was right"
    np.testing.assert_allclose(world.mapper.trajectory()[:, 1], [0.0, 2.0, 3.0])
    world.scan(at={2.0: {1.0: 0.1}, 3.0: {1.0: 0.8}})
    assert world.count == 1, "the first place is clearly behind"


def test_paths_that_meet_are_merged(world: World) -> None:
    world.scan({1.0: 0.6, 2.0: 0.5})
    world.scan(at={1.0: {2.0: 0.5}, 2.0: {1.0: 0.5}})
    assert world.count == 1
    np.testing.assert_allclose(world.mapper.trajectory()[:, 1], [0.0, 1.0, 3.0])


def test_number_of_paths_is_bounded(world: World) -> None:
    best = world.scan({1.0: 0.6, 10.0: 0.59, 20.0: 0.58, 30.0: 0.57})
    assert world.count == SETTINGS.places
    best += world.scan({1.0: 0.6, 100.0: 0.59}) - best
    assert world.count == SETTINGS.most
    assert best == 2.0


def test_late_scan_is_answered_and_does_not_change_the_paths(world: World) -> None:
    world.scan({1.0: 0.6, 2.0: 0.5})
    before = world.mapper.trajectory()
    late = world.mapper.add(scan_at(ORIGIN, beams=36, stamp=0.5))
    assert not late.accepted
    np.testing.assert_array_equal(world.mapper.trajectory(), before)
    assert world.count == 2


def test_relocated_robot_has_one_path(world: World) -> None:
    world.scan({1.0: 0.6, 2.0: 0.5})
    world.mapper.relocate(Pose(7.0, 0.0, 0.0))
    assert world.count == 1
    assert world.scan({1.0: 0.6}) == 8.0


def test_restored_mapper_follows_the_same_paths(world: World) -> None:
    world.scan({1.0: 0.6, 2.0: 0.5})
    saved = dict(flatten(world.mapper.state()))
    world.mapper = HypothesisMapper.restored(MapperSettings(), Reader(saved))
    assert world.count == 2
    assert world.scan(at={1.0: {1.0: 0.4}, 2.0: {1.0: 0.7}}) == 3.0


@pytest.mark.parametrize("values", [[], [0.5] * (SETTINGS.most + 1), [0.5, 0.4]])
def test_state_with_a_wrong_number_of_paths_is_refused(values: list[float]) -> None:
    saved = dict(flatten(HypothesisMapper().state()))
    with pytest.raises(InvalidRequest, match=r"values|paths/1"):
        HypothesisMapper.restored(MapperSettings(), Reader({**saved, "values": np.array(values, np.float64)}))
