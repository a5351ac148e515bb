"""Mapper `graph`: pose-graph SLAM for one robot."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.grid import GridMap, OccupancyGrid
from rce.mapping.history import History
from rce.mapping.mapper import MIN_POINTS, UNMATCHED_COVARIANCE, Estimate, MapperSettings
from rce.mapping.matching import local_map
from rce.mapping.matching.local_map import LocalMap
from rce.mapping.matching.wide_search import Candidate
from rce.mapping.motion import Motion
from rce.mapping.pose_graph.graph import PoseGraph
from rce.mapping.pose_graph.loops import LoopFinder
from rce.mapping.pose_graph.optimisation import settle
from rce.mapping.pose_graph.trail import Trail
from rce.mapping.scans import Scan
from rce.mapping.state import Reader, State

SHIFTED = 0.01  # metres or radians of motion of a node after which the grid is rendered again


class GraphMapper:
    """Graph SLAM with local maps.

    Hess et al., Real-Time Loop Closure in 2D LIDAR SLAM, 2016; Konolige et al., Efficient Sparse Pose Adjustment for 2D
    Mapping, 2010. Each scan is matched with the walls seen from the nodes around. A node is made, and scans are kept,
    only where no node near by looks the same way, so that memory grows with the building and not with time. Each
    complete node is compared with old ones near it; when a loop closes, all poses are optimised.
    """

    def __init__(self, settings: MapperSettings | None = None) -> None:
        """Start an empty map at the origin."""
        self.settings = settings or MapperSettings()
        self._graph = PoseGraph()
        self._local = LocalMap(self._scans_around, self.settings.max_range)
        self._loops = LoopFinder(self._graph)
        self._motion = Motion()
        self._history = History()
        self._stamp = -math.inf
        self._trail = Trail(self._graph, self._graph.add_node(ORIGIN))
        self._grid: GridMap | None = GridMap(self.settings.resolution)  # None if nodes have moved since

    def add(self, scan: Scan) -> Estimate:
        """Map the next scan. One that is not newer than those before is answered but not mapped."""
        return self.place(scan, next(iter(self.candidates(scan)), None))

    def candidates(self, scan: Scan) -> list[Candidate]:
        """Return the places where the robot may be at the next scan, the best first; none if it cannot be matched."""
        points = scan.points(self.settings.max_range)
        if not scan.stamp > self._stamp or len(points) < MIN_POINTS:
            return []
        motion = self._motion
        return self._local.candidates(points, motion.predict(scan), motion.spread(scan), motion.step_cost)

    def place(self, scan: Scan, candidate: Candidate | None) -> Estimate:
        """Map the next scan at one of its candidates; None if it has none."""
        if not scan.stamp > self._stamp:
            return self._answer_late(scan)
        self._stamp = scan.stamp
        points = scan.points(self.settings.max_range)
        found = candidate.match if candidate else None
        pose = found.pose if found else self._motion.predict(scan)[0]
        usable = len(points) >= MIN_POINTS
        contradicts = usable and found is None and self._local.contains(pose)  # such a scan is not kept
        reliable = found.unambiguous if found else not contradicts
        covariance = found.covariance if found else UNMATCHED_COVARIANCE
        self._motion.update(scan, pose, reliable, found.covariance if found else None)
        closed = self._keep(pose, points, covariance, reliable) if usable and not contradicts else None
        self._history.append(scan.stamp, self._trail.reference, self._trail.relative(pose))
        if closed is not None:
            self._close_loops(closed)
        return Estimate(scan.stamp, self._motion.pose, covariance, found is not None)

    def copy(self) -> GraphMapper:
        """Return a mapper with the same map, which goes on by itself."""
        other = copy.copy(self)
        other._graph = self._graph.copy()
        other._loops = self._loops.copy(other._graph)
        other._trail = self._trail.copy(other._graph)
        other._local = self._local.copy(other._scans_around)
        other._motion, other._history = copy.deepcopy((self._motion, self._history))
        other._grid = None
        return other

    def grid(self) -> OccupancyGrid:
        """Return the current map."""
        if self._grid is None:
            self._grid = GridMap(self.settings.resolution)
            for node in self._graph.nodes.values():
                for sweep in node.sweeps:
                    self._grid.insert(*sweep.seen_from(node.pose))
        return self._grid.render()

    @property
    def pose(self) -> Pose:
        """Pose of the robot at the last scan, map frame."""
        return self._motion.pose

    @property
    def graph(self) -> PoseGraph:
        """The pose graph, to be read only."""
        return self._graph

    @property
    def history(self) -> History:
        """Poses of the scans relative to nodes, to be read only."""
        return self._history

    @property
    def reference(self) -> int:
        """Number of the node near the robot, with which its pose moves."""
        return self._trail.reference

    def trajectory_by(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the trajectory (n, 4) as it is if the nodes are at these poses (nodes, 3)."""
        return self._history.trajectory(poses)

    def trajectory(self) -> NDArray[np.float64]:
        """Return (n, 4) stamp, x, y, theta of every accepted scan, map frame."""
        return self._history.trajectory(self._graph.poses())

    def relocate(self, pose: Pose) -> None:
        """Continue at a pose (map frame) to which the robot was carried while nothing was recorded."""
        self._motion = Motion(pose)
        self._trail.relocate(pose)
        self._local.rebuild(pose)

    def state(self) -> State:
        """Return the mapper as arrays to save."""
        whole: State = {
            "graph": self._graph.state(),
            "loops": self._loops.state(),
            "motion": self._motion.state(),
            "history": self._history.state(),
            "stamp": np.array([self._stamp] if math.isfinite(self._stamp) else [], np.float64),
            "trail": self._trail.state(),
            "local": self._local.state(),
        }
        return whole if self._grid is None else {**whole, "grid": self._grid.state()}

    @classmethod
    def restored(cls, settings: MapperSettings, saved: Reader) -> GraphMapper:
        """Return a mapper that continues where a saved one stopped.

        Raises:
            InvalidRequest: The saved arrays are not the state of this mapper.
        """
        mapper = cls(settings)
        mapper._graph = graph = PoseGraph()
        graph.restore(saved.part("graph"))
        mapper._loops = LoopFinder(graph)
        mapper._loops.restore(saved.part("loops"))
        mapper._motion.restore(saved.part("motion"))
        count = len(graph.nodes)
        mapper._history.restore(saved.part("history"), count)
        mapper._stamp = max(saved.array("stamp", np.float64, None).tolist(), default=-math.inf)
        mapper._trail = Trail.restored(graph, saved.part("trail"))
        if saved.has("local"):
            mapper._local.restore(saved.part("local"), count)
        mapper._grid = None
        if saved.has("grid"):
            mapper._grid = GridMap(settings.resolution)
            mapper._grid.restore(saved.part("grid"))
        return mapper

    def _answer_late(self, scan: Scan) -> Estimate:
        """Return the pose at the stamp of a scan that comes too late to be mapped."""
        if not len(self._history):
            return Estimate(scan.stamp, ORIGIN, UNMATCHED_COVARIANCE, matched=False, accepted=False)
        node, relative = self._history.at(scan.stamp)
        return Estimate(
            scan.stamp, self._graph.nodes[node].pose @ relative, UNMATCHED_COVARIANCE, matched=False, accepted=False
        )

    def _scans_around(self, pose: Pose) -> Iterator[tuple[int, Points, Points]]:
        """Yield the scans of nodes near a pose and, along edges, near the robot.

        These are the nodes that were passed lately, and those passed long ago where a loop is closed.
        """
        for number in sorted(self._graph.distances(self._trail.reference, local_map.SETTINGS.way)):
            node = self._graph.nodes[number]
            if math.dist(node.pose[:2], pose[:2]) < local_map.SETTINGS.radius:
                for sweep in node.sweeps:
                    yield number, *sweep.seen_from(node.pose)

    def _keep(self, pose: Pose, points: Points, covariance: NDArray[np.float64], reliable: bool) -> int | None:
        """Keep the scan if it shows something new; return the node that this completes, if any."""
        if reliable and not self._trail.has_moved(pose):
            return None
        complete = self._trail.advance(pose, points, covariance, self._local.places, reliable)
        if self._trail.is_open:
            node = self._graph.nodes[self._trail.reference]
            self._local.add(self._trail.reference, pose.transform(points))
            if self._grid is not None:
                self._grid.insert(*node.sweeps[-1].seen_from(node.pose))
        self._local.recentre(pose)
        return complete

    def _close_loops(self, complete: int) -> None:
        """Search loops at a complete node, and optimise if there are any."""
        closures = self._loops.search(complete)
        if not closures:
            return
        self._graph.add_edges(closures)
        self._optimise()

    def _optimise(self) -> None:
        """Optimise all poses, and move the robot along."""
        relative = self._trail.relative(self._motion.pose)
        if settle(self._graph) > SHIFTED:
            self._grid = None
        self._motion.correct(self._graph.nodes[self._trail.reference].pose @ relative)
        self._local.rebuild(self._motion.pose)
