"""The dense map of all robots, kept consistent with their moving key frames."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from rce.errors import InvalidRequest
from rce.mapping.files.outputs import write_atomically, write_map
from rce.mapping.grid import OccupancyGrid
from rce.mapping3d.dense.floor_plan import cut
from rce.mapping3d.dense.frontiers import nearest_frontier
from rce.mapping3d.dense.kept_frames import Kept, KeptCloud, KeptFrame
from rce.mapping3d.dense.level import find_level
from rce.mapping3d.dense.marching_cubes import extract
from rce.mapping3d.dense.mesh import Cloud, Mesh
from rce.mapping3d.dense.octree import octree
from rce.mapping3d.dense.picture import draw
from rce.mapping3d.dense.ply import cloud_ply, mesh_ply
from rce.mapping3d.dense.volume import Volume, VolumeFull
from rce.mapping3d.frames import AnyKeyFrame, KeyFrame
from rce.mapping3d.poses import Pose, inverse, make_pose, transform

TRUNCATION = 3.0  # voxels


@dataclass(frozen=True, slots=True)
class DenseConfig:
    """Settings of the dense map.

    Attributes:
        voxel: Edge of a voxel, metres.
        max_depth: Depth beyond which measurements are not used, metres.
        max_blocks: Bound of the volume, blocks of 8 x 8 x 8 voxels of 10 kB. At the bound the voxels become twice as
            large.
        max_frames: Bound of the key frames that are kept, about 60 kB each. At the bound the one nearest to another is
            taken out of the map.
        cell: Edge of a cell of the grid, metres.
        robot_height: What is higher above the floor than this is no obstacle, metres.
        robot_radius: Distance that a robot keeps from obstacles, metres.
        axes: (4, 4) axes of a camera (x right, y down, z ahead) in the frame of the sensor.
    """

    voxel: float = 0.02
    max_depth: float = 4.5
    max_blocks: int = 50_000
    max_frames: int = 4_000
    cell: float = 0.05
    robot_height: float = 1.2
    robot_radius: float = 0.2
    axes: Pose = field(default_factory=lambda: np.eye(4))


DENSE_CONFIG = DenseConfig()
# A key frame of a lidar takes about 200 kB. Its x axis points ahead, its z axis up.
LIDAR_CONFIG = DenseConfig(
    voxel=0.06,
    max_frames=2_000,
    axes=make_pose([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0, 0, 0]),
)


SETTLED = 0.005  # metres: a frame that is less out of its place stays there
AT_ONCE = 5  # key frames that are put in their new places with each that is added


class DenseMap:
    """Surface, cloud and floor plan from key frames. All results are in the frame of the poses, except the grid.

    The grid is in the level frame: z up, x along the view of the first camera, or ahead of the first lidar, and the
    origin on the floor below it. One thread at a time may use the map.
    """

    def __init__(self, config: DenseConfig = DENSE_CONFIG) -> None:
        """Make an empty map."""
        self.config = config
        self._frames: dict[tuple[int, int], Kept] = {}
        self._volume = self._empty(config.voxel)
        self._mesh: Mesh | None = None  # None after a change

    @property
    def voxel(self) -> float:
        """Edge of a voxel, metres; larger than configured when the map has outgrown `max_blocks`."""
        return self._volume.voxel

    def add(self, key_frame: AnyKeyFrame, pose: Pose) -> None:
        """Add a key frame at its pose, sensor to map. Takes about 20 ms at QVGA; larger images are reduced.

        A few key frames that have moved are put in their places, those first that are furthest from them.

        Raises:
            InvalidRequest: The key frame is in the map already.
        """
        name = key_frame.robot, key_frame.index
        if name in self._frames:
            raise InvalidRequest(f"key frame {name[1]} of robot {name[0]} is in the map already; move it instead")
        if len(self._frames) >= self.config.max_frames:
            self._thin_out()
        kept: Kept
        if isinstance(key_frame, KeyFrame):
            kept = KeptFrame(key_frame, pose, self.config.max_depth)
        else:
            kept = KeptCloud(key_frame, pose)
        self._frames[name] = kept
        self._integrate([kept])
        self._settle(AT_ONCE)

    def move(self, robot: int, index: int, pose: Pose) -> None:
        """Tell the pose at which a key frame is now. The map follows with the next ones added, or with a result.

        Key frames that are not in the map (any more) are ignored. Cheap: call it for all of them after a loop.
        """
        kept = self._frames.get((robot, index))
        if kept is not None:
            kept.wanted = pose.copy()

    def remove(self, robot: int, index: int) -> None:
        """Take a key frame out of the map."""
        kept = self._frames.pop((robot, index), None)
        if kept is not None:
            kept.take_from(self._volume)
            self._volume.collect()
            self._mesh = None

    def level(self) -> Pose:
        """Return the pose that takes points of the map to the level frame (see the class)."""
        frames = [self._frames[name] for name in sorted(self._frames)]
        cloud = self.cloud()
        axes = self.config.axes
        return find_level(cloud, [kept.pose @ axes for kept in frames]) if frames else np.eye(4)

    def mesh(self) -> Mesh:
        """Return the surface."""
        self._settle(len(self._frames))
        if self._mesh is None:
            self._mesh = extract(self._volume)
        return self._mesh

    def cloud(self) -> Cloud:
        """Return points of the surface, one to three for each voxel that it passes."""
        return self.mesh().cloud

    def grid(self) -> OccupancyGrid:
        """Return the floor plan for navigation, in the level frame."""
        level = self.level()
        surface = transform(level, self.cloud().points).astype(np.float32)
        views = [(level @ kept.pose, kept.points) for kept in self._frames.values()]
        return cut(surface, views, self.config.cell, self.config.robot_height)

    def next_goal(self, pose: Pose) -> Pose | None:
        """Return where a camera at `pose` should go next to see something new.

        None when all is explored, or nothing can be reached over floor that was seen, from 1 m around the camera on.
        The goal is as high as the camera is, looks level at the unknown, and is a pose in the frame of the map.
        """
        level = self.level()
        x, y, z = (level @ pose)[:3, 3].tolist()
        goal = nearest_frontier(self.grid(), x, y, self.config.robot_radius)
        if goal is None:
            return None
        c, s = math.cos(goal.heading), math.sin(goal.heading)
        rotation = np.array([[s, 0.0, c], [-c, 0.0, s], [0.0, -1.0, 0.0]])
        found: Pose = inverse(level) @ make_pose(rotation, [goal.x, goal.y, z]) @ inverse(self.config.axes)
        return found

    def write(self, directory: Path, paths: Mapping[int, Sequence[Pose]]) -> list[Path]:
        """Write cloud.ply, mesh.ply, map.bt, map.pgm, map.yaml and view.png; return their paths.

        Args:
            directory: Directory, created if it does not exist.
            paths: The poses of each robot's camera along its way, for the picture.
        """
        directory.mkdir(parents=True, exist_ok=True)
        mesh, level = self.mesh(), self.level()
        contents = {
            "cloud.ply": cloud_ply(mesh.cloud, level),
            "mesh.ply": mesh_ply(mesh, level),
            "map.bt": octree(*self._volume.centres(), self._volume.voxel),
            "view.png": draw(mesh, paths, level),
        }
        for name, content in contents.items():
            write_atomically(directory / name, content)
        write_map(directory / "map", self.grid())
        return [directory / name for name in (*contents, "map.pgm", "map.yaml")]

    def _empty(self, voxel: float) -> Volume:
        return Volume(voxel, TRUNCATION * voxel, self.config.max_blocks)

    def _integrate(self, frames: Iterable[Kept]) -> None:
        """Put images into the volume. When it is full, all that it had goes into one of voxels twice as large."""
        self._mesh = None
        waiting = list(frames)
        done = [kept for kept in self._frames.values() if kept not in waiting]
        while waiting:
            kept = waiting.pop()
            try:
                kept.put_into(self._volume)
                done.append(kept)
            except VolumeFull:
                self._volume = self._empty(2 * self._volume.voxel)
                waiting += [*done, kept]
                done = []

    def _settle(self, limit: int) -> None:
        """Put at most so many frames where they should be, the furthest first (Dai et al., BundleFusion, 2017)."""
        astray = sorted((kept for kept in self._frames.values() if kept.offset() > SETTLED), key=Kept.offset)
        chosen = astray[-limit:]
        for kept in chosen:
            kept.take_from(self._volume)
            kept.pose = kept.wanted
        if chosen:
            self._integrate(chosen)
            self._volume.collect()

    def _thin_out(self) -> None:
        """Remove the key frame that shows least that others do not: the later one of the two closest to each other."""
        names = list(self._frames)
        places = np.array([[*kept.pose[:3, 3], *kept.pose[:3, 2]] for kept in self._frames.values()])
        distances, _ = cKDTree(places).query(places, k=2)
        closest = np.flatnonzero(distances[:, 1] <= distances[:, 1].min() + 1e-9)
        self.remove(*names[closest[-1]])
