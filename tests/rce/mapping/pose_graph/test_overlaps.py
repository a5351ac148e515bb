"""Finding a place of one robot in the whole map of another."""

from __future__ import annotations

import numpy as np
import pytest

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.pose_graph.graph import PoseGraph, Sweep
from rce.mapping.pose_graph.overlaps import SETTINGS, WholeMap, place_points
from tests.support.laser import PLACE, SENSOR, sweep_at

AT = Pose(14.0, 17.0, 2.5)


def walls(seed: int = 0) -> Points:
    """Return points on 60 walls of 2 m at random places of a hall of 30 m."""
    corners = np.random.default_rng(seed).uniform(0, 30, (60, 2))
    along = np.linspace(0, 2, 40)[:, None]
    return np.concatenate([corner + along * ([1, 0] if i % 2 else [0, 1]) for i, corner in enumerate(corners)])


def seen_at(pose: Pose) -> Points:
    """Return what a robot at `pose` sees of these walls, in its frame."""
    points = pose.inverse().transform(walls())
    near: Points = points[np.hypot(*points.T) < 12][::3]
    return near


def add_node(graph: PoseGraph, pose: Pose, points: Points) -> None:
    graph.nodes[graph.add_node(pose)].sweeps.append(Sweep(SENSOR, points.astype(np.float32)))


def map_of(points: Points) -> PoseGraph:
    graph = PoseGraph()
    add_node(graph, ORIGIN, points)
    return graph


def test_place_is_found_anywhere_in_a_whole_map() -> None:
    found = WholeMap(map_of(walls())).find(seen_at(AT))
    assert found is not None
    off = AT.to(found.motion)
    assert np.hypot(off.x, off.y) < 0.05
    assert abs(off.theta) < 0.01
    assert np.linalg.eigvalsh(found.information).min() > 0


def test_strange_place_is_not_found() -> None:
    assert WholeMap(map_of(walls())).find(np.random.default_rng(1).uniform(-10, 10, (300, 2))) is None


def test_map_that_has_grown_is_searched_anew() -> None:
    graph = map_of(walls(seed=1) - 40.0)
    whole = WholeMap(graph)
    assert whole.find(seen_at(AT)) is None
    for piece in np.array_split(walls(), SETTINGS.new_nodes):
        add_node(graph, ORIGIN, piece)
    found = whole.find(seen_at(AT))
    assert found is not None
    assert found.motion == pytest.approx(AT, abs=0.05)


def test_map_that_was_corrected_is_searched_anew() -> None:
    graph, shift = map_of(walls()), Pose(5.0, 3.0, -0.5)
    whole = WholeMap(graph)
    first = whole.find(seen_at(AT))
    graph.nodes[0].pose = shift
    second = whole.find(seen_at(AT))
    assert first is not None
    assert second is not None
    assert first.motion == pytest.approx(AT, abs=0.05)
    assert second.motion == pytest.approx(shift @ AT, abs=0.05)


def test_points_of_a_place_are_thinned_and_near() -> None:
    graph = PoseGraph()
    graph.nodes[graph.add_node(PLACE)].sweeps.append(sweep_at(PLACE, beams=720))
    points = place_points(graph, 0)
    assert points is not None
    assert SETTINGS.search.min_points <= len(points) <= SETTINGS.search.max_points
    assert np.hypot(*points.T).max() < SETTINGS.search.view


def test_place_with_few_points_is_not_recognised() -> None:
    assert place_points(map_of(np.ones((9, 2))), 0) is None
