"""Local map around the robot."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.matching.local_map import SETTINGS, LocalMap
from rce.mapping.state import Reader, flatten
from tests.support.laser import PLACE, SENSOR, points_at

NEAR = Pose(0.2, -0.1, 0.05)


def empty() -> LocalMap:
    return LocalMap(lambda _: iter(()), 12.0)


def around(pose: Pose) -> Iterator[tuple[int, Points, Points]]:
    """Yield two scans of the first room, each five times."""
    for place in (3, 4):
        for _ in range(5):
            yield place, SENSOR, points_at(PLACE)


def filled() -> LocalMap:
    local = LocalMap(around, 12.0)
    local.rebuild(ORIGIN)
    return local


def off(found: Pose, truth: Pose) -> float:
    return math.hypot(*truth.to(found)[:2])


def test_nothing_is_matched_with_an_empty_map() -> None:
    assert empty().match(points_at(PLACE), [ORIGIN], 0.1) is None
    assert not empty().contains(ORIGIN)


def test_scan_near_the_prediction_is_matched() -> None:
    found = filled().match(points_at(PLACE @ NEAR), [ORIGIN], 0.1)
    assert found is not None
    assert off(found.pose, NEAR) < 0.02


def test_prediction_outside_of_the_map_is_left_out() -> None:
    local, far = filled(), Pose(500.0, 0.0, 0.0)
    assert local.match(points_at(PLACE), [far], 0.1) is None
    found = local.match(points_at(PLACE @ NEAR), [far, ORIGIN], 0.1)
    assert found is not None
    assert off(found.pose, NEAR) < 0.02


@pytest.mark.parametrize(("motion", "spread"), [(Pose(1.0, 0.3, 0.8), 0.1), (Pose(0.7, 0.2, 1.2), math.inf)])
def test_larger_window_is_searched_if_the_motion_is_larger_than_predicted(motion: Pose, spread: float) -> None:
    found = filled().match(points_at(PLACE @ motion), [ORIGIN], spread)
    assert found is not None
    assert off(found.pose, motion) < 0.05


def test_several_places_are_candidates_if_the_motion_is_unknown() -> None:
    x = np.arange(-15.0, 15.0, 0.05)
    corridor = np.concatenate([np.stack([x, np.full(len(x), side)], axis=1) for side in (-1.0, 1.0)])
    local = LocalMap(lambda _: iter([(0, SENSOR, corridor)] * 5), 20.0)
    local.rebuild(ORIGIN)
    part = corridor[np.abs(corridor[:, 0]) < 8.0]
    assert len(local.candidates(part, [ORIGIN], 0.1)) == 1
    places = local.candidates(part, [ORIGIN], math.inf, lambda pose: 0.2 * abs(abs(pose.x) - 2.0))
    assert len(places) > 1
    assert abs(places[0].match.pose.x) == pytest.approx(2.0, abs=0.2)


def test_scan_that_contradicts_the_map_has_no_place() -> None:
    points, ranges = points_at(PLACE), np.random.default_rng(0).uniform(0.3, 3.0, 360)
    rain = points / np.hypot(*points.T)[:, None] * ranges[:, None]
    local = filled()
    assert local.contains(ORIGIN)
    assert local.candidates(rain, [ORIGIN], math.inf) == []


def test_copied_map_takes_scans_by_itself() -> None:
    local = filled()
    other = local.copy(around)
    other.add(9, points_at(PLACE @ Pose(1.0, 0.0, 0.0)))
    assert (local.places, other.places) == ({3, 4}, {3, 4, 9})
    first, second = (each.match(points_at(PLACE @ NEAR), [ORIGIN], 0.1) for each in (local, filled()))
    assert first is not None
    assert second is not None
    assert (first.pose, first.score) == (second.pose, second.score), "the walls are those of before"


def test_map_has_the_places_of_its_scans() -> None:
    local = filled()
    assert local.places == {3, 4}
    local.add(9, points_at(PLACE))
    assert local.places == {3, 4, 9}
    local.rebuild(ORIGIN)
    assert local.places == {3, 4}, "only those that are around"


def test_map_is_rebuilt_when_the_robot_has_driven_far() -> None:
    centres: list[Pose] = []

    def record(pose: Pose) -> Iterator[tuple[int, Points, Points]]:
        centres.append(pose)
        return iter(())

    local = LocalMap(record, 12.0)
    for x in (0.0, 0.9 * SETTINGS.margin, 1.1 * SETTINGS.margin, 1.2 * SETTINGS.margin):
        local.recentre(Pose(x, 0.0, 0.0))
    assert [pose.x for pose in centres] == [0.0, 1.1 * SETTINGS.margin]


def test_restored_map_matches_alike() -> None:
    local, other = filled(), empty()
    other.restore(Reader(dict(flatten(local.state()))), 5)
    assert other.places == {3, 4}
    first, second = (each.match(points_at(PLACE @ NEAR), [ORIGIN], 0.1) for each in (local, other))
    assert first is not None
    assert second is not None
    assert (first.pose, first.score) == (second.pose, second.score)


def test_empty_map_has_no_state() -> None:
    assert empty().state() == {}


@pytest.mark.parametrize(("name", "places"), [("centre", 5), ("likelihood", 5), ("tiles", 5), ("places", 4)])
def test_damaged_state_is_refused(name: str, places: int) -> None:
    state = dict(flatten(filled().state()))
    if name != "places":  # there, the number of places is too small
        state[name] = state[name][:0]
    with pytest.raises(InvalidRequest, match=name):
        empty().restore(Reader(state), places)


def test_far_points_are_ignored() -> None:
    local = filled()
    local.add(5, np.array([[1e5, -1e5]]))
    found = local.match(points_at(PLACE), [ORIGIN], 0.1)
    assert found is not None
    assert off(found.pose, ORIGIN) < 0.01
