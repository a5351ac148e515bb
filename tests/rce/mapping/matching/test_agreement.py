"""Tests of the agreement of two places on walls and free space."""

from __future__ import annotations

import pytest

from rce.mapping.evaluation.simulation.floor_plan import FloorPlan, apartment
from rce.mapping.geometry import Pose
from rce.mapping.matching.agreement import Surroundings, agreement
from rce.mapping.pose_graph.graph import PoseGraph
from tests.support.laser import sweep_at


def seen_at(pose: Pose, plan: FloorPlan) -> Surroundings:
    graph = PoseGraph()
    graph.add_node(pose)
    graph.nodes[0].sweeps.append(sweep_at(pose, plan, 720))
    return Surroundings(graph, 0, 1.0)


ONE, OTHER = Pose(2.6, 3.4, 0.3), Pose(1.6, 2.6, -2.0)


def test_two_views_of_a_room_agree_at_the_true_pose() -> None:
    assert agreement(seen_at(ONE, apartment()), seen_at(OTHER, apartment()), ONE.to(OTHER)) > 0.97


@pytest.mark.parametrize("off", [Pose(1.0, 0.0, 0.0), Pose(0.0, -1.0, 0.0), Pose(0.0, 0.0, 0.5)], ids=str)
def test_two_views_of_a_room_disagree_at_other_poses(off: Pose) -> None:
    assert agreement(seen_at(ONE, apartment()), seen_at(OTHER, apartment()), ONE.to(OTHER) @ off) < 0.85


def test_places_without_overlap_do_not_agree() -> None:
    here = seen_at(ONE, apartment())
    assert agreement(here, here, Pose(100.0, 0.0, 0.0)) == 0.0
