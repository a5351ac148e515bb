from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from rce.errors import InvalidRequest
from rce.mapping.evaluation.simulation.floor_plan import FloorPlan
from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.particles.path_graph import PathGraph
from rce.mapping.pose_graph.graph import Edge
from rce.mapping.state import Reader, flatten
from tests.support.laser import RANGE_MAX, scan_at

CERTAIN = np.diag([1e-4, 1e-4, 1e-5])
SIDE, HALF = 16.0, 1.5  # metres; side of the square that the robot drives around, and half the width of the corridor
Array = NDArray[np.float64]


def square(half: float) -> Array:
    """Return the walls (4, 2, 2) of a square around the centre of the building."""
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def building() -> FloorPlan:
    """Return a corridor around a square, with pillars along the walls, so that no two places look alike."""
    random, walls = np.random.default_rng(1), [square(SIDE / 2 - HALF), square(SIDE / 2 + HALF)]
    for _ in range(40):
        side = random.uniform(-SIDE / 2, SIDE / 2), random.choice([-1, 1]) * (SIDE / 2 + random.choice([-1, 1]) * HALF)
        centre = np.array(side if random.random() < 0.5 else side[::-1])
        walls.append(square(random.uniform(0.15, 0.4)) + centre)
    return FloorPlan(np.concatenate(walls))


def drive(metres: float) -> list[Pose]:
    """Return the poses, half a metre apart, of a robot that drives around the square from a corner."""
    poses = [Pose(-SIDE / 2, -SIDE / 2, 0.0)]
    for i in range(int(2 * metres)):
        turn = math.pi / 2 if i % (2 * SIDE) == 2 * SIDE - 1 else 0.0
        poses.append(poses[-1] @ Pose(0.5, 0.0, turn))
    return poses


@dataclass
class Driven:
    """Robot whose path drifts by an error at each step, until the graph corrects it.

    Attributes:
        drift: The error.
        truth: True poses.
        graph: The graph.
        path: (n, 3) path so far, frame of the first pose.
        corrected: Steps at which the path was corrected.
    """

    drift: Pose
    truth: list[Pose] = field(default_factory=lambda: drive(4 * SIDE + 10.0))
    graph: PathGraph = field(default_factory=PathGraph)
    path: Array = field(default_factory=lambda: np.empty((0, 3)))
    corrected: list[int] = field(default_factory=list)

    def drive(self, end: int | None = None) -> None:
        """Drive to this step; None for all."""
        plan = building()
        for number, pose in list(enumerate(self.truth))[len(self.path) : end]:
            before = Pose(*self.path[-1].tolist()) if number else ORIGIN
            motion = self.truth[number - 1].to(pose) @ self.drift if number else ORIGIN
            self.path = np.concatenate([self.path, [before @ motion]])
            corrected = self.graph.extend(self.path, scan_at(pose, plan).points(RANGE_MAX), CERTAIN)
            if corrected is not None:
                self.path = corrected
                self.corrected.append(number)

    def error(self) -> float:
        """Return the metres between the path and the truth at most."""
        true = np.array([self.truth[0].to(pose) for pose in self.truth[: len(self.path)]])
        return float(np.hypot(*(self.path - true)[:, :2].T).max())


def test_path_that_contradicts_a_loop_is_corrected() -> None:
    robot = Driven(Pose(0.0, 0.0, 0.002))
    robot.drive(int(2 * 4 * SIDE) - 1)
    assert not robot.corrected
    open_end = robot.truth[0].to(robot.truth[len(robot.path) - 1])
    assert math.dist(robot.path[-1, :2], open_end[:2]) > 2.0
    robot.drive()
    assert len(robot.corrected) == 1
    assert robot.error() < 0.5


def test_corrected_path_is_that_of_the_graph() -> None:
    robot = Driven(Pose(0.0, 0.0, 0.002))
    robot.drive()
    assert len(robot.corrected) == 1
    assert not robot.graph.follow(robot.path)


def test_path_that_agrees_with_a_loop_is_left_as_it_is() -> None:
    robot = Driven(ORIGIN)
    robot.drive()
    assert any(edge.closure and edge.second - edge.first > 20 for edge in robot.graph.graph.edges)
    assert not robot.corrected


def test_closures_are_kept_when_another_path_contradicts_them() -> None:
    """Another particle may become the best one after a loop was found that the path before had closed."""
    robot = Driven(ORIGIN)
    robot.drive(len(robot.truth) - 1)
    assert not robot.corrected
    bend = np.linspace(0.0, 2.0, len(robot.path) - 20)
    robot.path[20:, 1] += bend
    assert robot.error() == pytest.approx(2.0)
    robot.drive()
    assert len(robot.corrected) == 1
    assert robot.error() < 1.0
    assert math.dist(robot.path[-1, :2], robot.truth[0].to(robot.truth[-1])[:2]) < 0.3


def test_path_is_left_as_it_is_by_closures_that_are_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Driven(ORIGIN)
    robot.drive(60)
    nodes = robot.graph.graph.nodes
    wrong = [
        Edge(i, i + 10, nodes[i].pose.to(nodes[i + 10].pose) @ Pose(0.0, 3.0, 0.0), 400 * np.eye(3), closure=True)
        for i in range(3)
    ]
    monkeypatch.setattr(robot.graph._loops, "search", lambda node: wrong)
    before = robot.path
    robot.drive(66)
    assert not robot.corrected
    np.testing.assert_array_equal(robot.path[:60], before)
    assert not robot.graph.follow(robot.path)
    assert not any(edge.motion == wrong[0].motion for edge in robot.graph.graph.edges)


def test_restored_graph_continues_exactly() -> None:
    robot = Driven(Pose(0.0, 0.0, 0.002))
    robot.drive(100)
    robot.path[40:, 1] += 0.1  # of another particle
    robot.drive(110)
    saved = Reader(dict(flatten(robot.graph.state())))
    restored = PathGraph.restored(saved, len(robot.path))
    assert restored.graph.distances(0) == robot.graph.graph.distances(0)
    other = Driven(robot.drift, graph=restored, path=robot.path)
    for each in (robot, other):
        each.drive()
    assert robot.corrected == other.corrected != []
    np.testing.assert_array_equal(robot.path, other.path)
    with pytest.raises(InvalidRequest, match="steps"):
        PathGraph.restored(saved, 10)
