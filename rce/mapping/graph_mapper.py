"""The mapper that closes loops."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.graph import Edge, PoseGraph, Sweep, information_of
from rce.mapping.grid import GridMap, OccupancyGrid
from rce.mapping.history import History
from rce.mapping.local_map import AROUND, WAY, LocalMap
from rce.mapping.loops import LoopFinder
from rce.mapping.mapper import FEWEST_POINTS, UNCERTAIN, Estimate, MapperSettings
from rce.mapping.motion import Motion
from rce.mapping.optimisation import disagreement, optimise
from rce.mapping.scans import Scan
from rce.mapping.state import Reader, State, optional

MOVE, TURN = 0.2, 0.1  # metres, radians between scans that are kept
NODE_MOVE, NODE_TURN = 1.0, 0.5  # metres, radians between nodes
LINK_WAY, LINK_REACH = 5.0, 3.0  # metres along edges at least, and metres at most, to an old node linked in passing
FLOOR, SCALE = (0.01, math.radians(0.3)), 4.0  # see information_of
LINK_FLOOR = (0.03, math.radians(0.5))
WRONG = 50.0  # squared Mahalanobis distance; a closure that is further off after all is dropped
SHIFTED = 0.01  # metres or radians; when a node moves further, the grid is rendered anew


class GraphMapper:
    """Graph SLAM with local maps (Hess et al., Real-Time Loop Closure in 2D LIDAR SLAM, 2016; Konolige et al.,
    Efficient Sparse Pose Adjustment for 2D Mapping, 2010).

    Each scan is matched with the walls seen from the nodes around. A node is made, and scans are kept, only where no
    node near by looks the same way, so that memory grows with the building and not with time. Each complete node is
    compared with old ones near it; when a loop closes, all poses are optimised.
    """

    def __init__(self, settings: MapperSettings | None = None) -> None:
        self.settings = settings or MapperSettings()
        self._graph = PoseGraph()
        self._local = LocalMap(self._around, self.settings.max_range)
        self._loops = LoopFinder(self._graph)
        self._motion = Motion()
        self._history = History()
        self._stamp = -math.inf
        self._reference = self._graph.add_node(ORIGIN)  # the node near the robot, to whose frame its pose is fixed
        self._open: int | None = self._reference  # the node that gets scans
        self._kept: Pose | None = None  # where the last scan was looked at for keeping, frame of the reference
        self._grid: GridMap | None = GridMap(self.settings.resolution)  # None if nodes have moved since

    def add(self, scan: Scan) -> Estimate:
        if not scan.stamp > self._stamp:
            return self._late(scan)
        self._stamp = scan.stamp
        points = scan.points(self.settings.max_range)
        predictions = self._motion.predict(scan)
        usable = len(points) >= FEWEST_POINTS
        found = self._local.match(points, predictions, self._motion.spread(scan)) if usable else None
        sure = found is None or found.sure
        pose = found.pose if found else predictions[0]
        covariance = found.covariance if found else UNCERTAIN
        self._motion.follow(scan, pose, sure)
        closed = self._keep(pose, points, covariance, sure) if usable else None
        reference = self._graph.nodes[self._reference].pose
        self._history.append(scan.stamp, self._reference, reference.to(pose))
        if closed is not None:
            self._close_loops(closed)
        return Estimate(scan.stamp, self._motion.pose, covariance, found is not None)

    def grid(self) -> OccupancyGrid:
        if self._grid is None:
            self._grid = GridMap(self.settings.resolution)
            for node in self._graph.nodes.values():
                for sweep in node.sweeps:
                    self._render(self._grid, node.pose, sweep)
        return self._grid.render()

    @property
    def graph(self) -> PoseGraph:
        """What has been measured, to be read only."""
        return self._graph

    @property
    def reference(self) -> int:
        """The node near the robot, with which its pose moves."""
        return self._reference

    def trajectory_by(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """The trajectory if the nodes were at these poses (nodes, 3)."""
        return self._history.trajectory(poses)

    def trajectory(self) -> NDArray[np.float64]:
        return self._history.trajectory(self._graph.poses())

    def relocate(self, pose: Pose) -> None:
        """The robot was carried to a pose (map frame) while nothing was recorded."""
        nodes = self._graph.nodes
        self._motion = Motion(pose)
        self._reference = min(nodes, key=lambda number: math.dist(nodes[number].pose[:2], pose[:2]))
        self._open = self._kept = None
        self._local.renew(pose)

    def state(self) -> State:
        whole: State = {
            "graph": self._graph.state(),
            "loops": self._loops.state(),
            "motion": self._motion.state(),
            "history": self._history.state(),
            "stamp": np.array([self._stamp] if math.isfinite(self._stamp) else [], np.float64),
            "reference": np.array(self._reference, np.int64),
            "open": np.array(-1 if self._open is None else self._open, np.int64),
            "kept": optional(self._kept),
            "local": self._local.state(),
        }
        return whole if self._grid is None else {**whole, "grid": self._grid.state()}

    @classmethod
    def restored(cls, settings: MapperSettings, saved: Reader) -> GraphMapper:
        """A mapper that goes on where the one that was saved was. InvalidRequest if the state is nonsense."""
        mapper = cls(settings)
        mapper._graph = graph = PoseGraph()
        graph.restore(saved.part("graph"))
        mapper._loops = LoopFinder(graph)
        mapper._loops.restore(saved.part("loops"))
        mapper._motion.restore(saved.part("motion"))
        count = len(graph.nodes)
        mapper._history.restore(saved.part("history"), count)
        mapper._stamp = max(saved.array("stamp", np.float64, None).tolist(), default=-math.inf)
        mapper._reference = saved.whole("reference", count)
        mapper._open = saved.whole("open", count, lowest=-1)
        mapper._open = None if mapper._open < 0 else mapper._open
        mapper._kept = saved.optional("kept")
        if saved.has("local"):
            mapper._local.restore(saved.part("local"), count)
        mapper._grid = None
        if saved.has("grid"):
            mapper._grid = GridMap(settings.resolution)
            mapper._grid.restore(saved.part("grid"))
        return mapper

    def _late(self, scan: Scan) -> Estimate:
        if not len(self._history):
            return Estimate(scan.stamp, ORIGIN, UNCERTAIN, matched=False, taken=False)
        node, relative = self._history.at(scan.stamp)
        return Estimate(scan.stamp, self._graph.nodes[node].pose @ relative, UNCERTAIN, matched=False, taken=False)

    def _around(self, pose: Pose) -> Iterator[tuple[int, Points, Points]]:
        """The nodes near a pose and near the robot along the edges: what was passed lately, and what was passed long
        ago where a loop is closed."""
        for number in sorted(self._graph.distances(self._reference, WAY)):
            node = self._graph.nodes[number]
            if math.dist(node.pose[:2], pose[:2]) < AROUND:
                for sweep in node.sweeps:
                    points = node.pose.transform(sweep.points.astype(np.float64))
                    yield number, node.pose.transform(sweep.sensor), points

    def _keep(self, pose: Pose, points: Points, covariance: NDArray[np.float64], sure: bool) -> int | None:
        """Keep the scan if it shows something new. Returns a node that is complete thereby, if one is."""
        relative = self._graph.nodes[self._reference].pose.to(pose)
        if sure and self._kept is not None and not self._kept.to(relative).moved(MOVE, TURN):
            return None
        before = self._open
        if sure:
            self._choose_node(pose, relative, covariance)
        else:
            self._reference = self._open = self._add_node(pose, relative, covariance)
        if self._open is not None:
            self._enter(self._open, pose, points)
        self._kept = self._graph.nodes[self._reference].pose.to(pose)
        self._local.follow(pose)
        return before if before != self._open else None

    def _choose_node(self, pose: Pose, relative: Pose, covariance: NDArray[np.float64]) -> None:
        """Decide at which node the robot is: the one of before, another one near by, or a new one."""
        if not relative.moved(NODE_MOVE, NODE_TURN):
            return
        nodes = self._graph.nodes
        near = [(math.dist(nodes[n].pose[:2], pose[:2]), n) for n in self._local.places]
        for _, number in sorted(near):
            if not nodes[number].pose.to(pose).moved(NODE_MOVE, NODE_TURN):
                self._reference, self._open = number, None
                return
        new = self._add_node(pose, relative, covariance)
        self._link(new, pose, covariance)
        self._reference = self._open = new

    def _add_node(self, pose: Pose, relative: Pose, covariance: NDArray[np.float64]) -> int:
        """A node tied to the reference. The edge of one whose pose is in doubt is weak and counts as a long way: loops
        are searched with what was before it, and what is wrong is put right there."""
        new = self._graph.add_node(pose)
        theta = self._graph.nodes[self._reference].pose.theta
        self._graph.add_edges([Edge(self._reference, new, relative, information_of(covariance, theta, FLOOR, SCALE))])
        return new

    def _link(self, new: int, pose: Pose, covariance: NDArray[np.float64]) -> None:
        """Tie a new node to one of an earlier pass, since its scan was matched with what was seen from there too."""
        nodes, ways = self._graph.nodes, self._graph.distances(new, LINK_WAY)
        near = [(math.dist(nodes[n].pose[:2], pose[:2]), n) for n in self._local.places if n not in ways]
        apart, old = min(near, default=(math.inf, -1))
        if apart < LINK_REACH:
            information = information_of(covariance, nodes[old].pose.theta, LINK_FLOOR, SCALE)
            self._graph.add_edges([Edge(old, new, nodes[old].pose.to(pose), information, closure=True)])

    def _enter(self, number: int, pose: Pose, points: Points) -> None:
        node = self._graph.nodes[number]
        relative = node.pose.to(pose)
        sweep = Sweep(np.array([relative[:2]]), relative.transform(points).astype(np.float32))
        node.sweeps.append(sweep)
        self._local.add(number, pose.transform(points))
        if self._grid is not None:
            self._render(self._grid, node.pose, sweep)

    @staticmethod
    def _render(grid: GridMap, pose: Pose, sweep: Sweep) -> None:
        grid.insert(pose.transform(sweep.sensor), pose.transform(sweep.points.astype(np.float64)))

    def _close_loops(self, complete: int) -> None:
        closures = self._loops.search(complete)
        if not closures:
            return
        self._graph.add_edges(closures)
        self._optimise()

    def _optimise(self) -> None:
        nodes = self._graph.nodes
        relative = nodes[self._reference].pose.to(self._motion.pose)
        poses = optimise(nodes, self._graph.edges)
        shift = max(np.abs(np.subtract(poses[n], node.pose)).max() for n, node in nodes.items())
        for number, pose in poses.items():
            nodes[number].pose = pose
        closures = [edge for edge in self._graph.edges if edge.closure]
        wrong = [e for e, off in zip(closures, disagreement(nodes, closures), strict=True) if off > WRONG]
        if wrong:
            self._graph.remove_edges(wrong)
        if shift > SHIFTED:
            self._grid = None
        self._motion.correct(nodes[self._reference].pose @ relative)
        self._local.renew(self._motion.pose)
