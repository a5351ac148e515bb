"""Truncated signed distance function in hashed blocks of voxels.

Curless and Levoy, A Volumetric Method for Building Complex Models from Range Images, 1996; Niessner et al., Real-time
3D Reconstruction at Scale Using Voxel Hashing, 2013; Dai et al., BundleFusion, 2017, for taking images out again.
"""

from __future__ import annotations

import itertools

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.camera import Camera, Depth
from rce.mapping3d.dense import kernels
from rce.mapping3d.dense.mesh import Vertices
from rce.mapping3d.frames import Image
from rce.mapping3d.poses import Pose, inverse, transform

MOST_IN_VIEW = 1 << 16  # blocks; a view of 5 m at 2 cm has a few thousand


class VolumeFull(Exception):
    """The volume has no room for the blocks of an image; nothing of the image was added."""


class Volume:
    """Signed distances, weights and colours of the voxels near surfaces. All of it is sums of integers.

    Attributes:
        voxel: Edge of a voxel, metres.
        truncation: Distance from a surface beyond which distances are cut off, metres.
        voxels: (capacity, 512, 5) int32 sums: weight x distance in units of truncation / `kernels.UNITS`, weight,
            weight x red, green and blue. Distances are positive on the side from which the surface was seen.
        blocks: (capacity, 3) int32 coordinates of the block in each slot, in blocks.
        live: (capacity,) bool, true for slots in use.
    """

    def __init__(self, voxel: float, truncation: float, capacity: int) -> None:
        """Make an empty volume of at most `capacity` blocks. The memory is taken as blocks are used."""
        self.voxel, self.truncation = voxel, truncation
        self.voxels = np.zeros((capacity, kernels.SIDE**3, kernels.CHANNELS), np.int32)
        self.blocks = np.zeros((capacity, 3), np.int32)
        self.live = np.zeros(capacity, np.bool_)
        entries = 1 << (2 * capacity - 1).bit_length()
        self.keys = np.full(entries, kernels.EMPTY, np.int64)
        self.slots = np.zeros(entries, np.int32)
        self._free = list(range(capacity - 1, -1, -1))

    def add(self, depth: Depth, color: Image, camera: Camera, pose: Pose) -> None:
        """Add an image.

        Args:
            depth: (height, width) float32, metres, 0 = none.
            color: (height, width, 3) uint8.
            camera: Of both images.
            pose: (4, 4) camera to map.

        Raises:
            VolumeFull: There is no room for what the image shows.
        """
        wanted = self._keys_in_view(depth, camera, pose)
        missing = wanted[self.look_up(wanted) < 0]
        if len(missing) > len(self._free):
            raise VolumeFull
        self._insert(missing)
        self._integrate(wanted, depth, color, camera, pose, 1)

    def remove(self, depth: Depth, color: Image, camera: Camera, pose: Pose) -> None:
        """Take an image out that was added with exactly these arguments."""
        self._integrate(self._keys_in_view(depth, camera, pose), depth, color, camera, pose, -1)

    def add_planes(self, points: Vertices, normals: Vertices, pose: Pose) -> None:
        """Add points that lie on planes.

        Args:
            points: (n, 3) float32, metres, frame of the sensor.
            normals: (n, 3) float32, unit vectors to the side from which they were seen.
            pose: (4, 4) sensor to map.

        Raises:
            VolumeFull: There is no room for them.
        """
        wanted = self._keys_near(points, pose)
        missing = wanted[self.look_up(wanted) < 0]
        if len(missing) > len(self._free):
            raise VolumeFull
        self._insert(missing)
        self._integrate_planes(points, normals, pose, 1)

    def remove_planes(self, points: Vertices, normals: Vertices, pose: Pose) -> None:
        """Take points out that were added with exactly these arguments."""
        self._integrate_planes(points, normals, pose, -1)

    def collect(self) -> None:
        """Free the blocks that no image shows any more."""
        before = self.live.copy()
        kernels.drop_unseen(self.voxels, self.live)
        gone = np.flatnonzero(before & ~self.live)
        if len(gone):
            self.voxels[gone] = 0
            self._free.extend(gone.tolist())
            self.keys.fill(kernels.EMPTY)
            kernels.fill_table(self.keys, self.slots, self.blocks, self.live)

    def centres(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the centres (n, 3), metres, of the voxels that were seen, and which (n,) of them are occupied.

        A voxel is occupied if a surface is nearer to its centre than half its edge, or it lies behind one.
        """
        slots = np.flatnonzero(self.live)
        sums = self.voxels[slots, :, :2]
        block, index = np.nonzero(sums[:, :, 1])
        within = np.stack([index & 7, index >> 3 & 7, index >> 6], axis=1)
        distance, weight = sums[block, index].T.astype(np.float64)
        limit = 0.5 * self.voxel / self.truncation * kernels.UNITS
        place = self.blocks[slots[block]] * kernels.SIDE + within
        occupied: NDArray[np.bool_] = distance < limit * weight
        return np.asarray((place + 0.5) * self.voxel, np.float64), occupied

    def look_up(self, keys: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the slots (n,) of the blocks with these keys (n,), -1 for those that are missing."""
        slots = np.empty(len(keys), np.int64)
        kernels.look_up(self.keys, self.slots, keys, slots)
        return slots

    def _keys_in_view(self, depth: Depth, camera: Camera, pose: Pose) -> NDArray[np.int64]:
        """Return the keys (n,) of the blocks near what an image shows. They depend on nothing but the image."""
        found = np.full(MOST_IN_VIEW, kernels.EMPTY, np.int64)
        edge = kernels.SIDE * self.voxel
        if kernels.find_blocks(depth, pose, _intrinsics(camera), edge, self.truncation, found) < 0:
            raise VolumeFull
        keys: NDArray[np.int64] = found[found != kernels.EMPTY]
        return keys

    def _keys_near(self, points: Vertices, pose: Pose) -> NDArray[np.int64]:
        """Return the keys (n,) of the blocks around points."""
        edge = kernels.SIDE * self.voxel
        moved = transform(pose, points)
        corners = [
            np.floor((moved + self.truncation * np.array(step)) / edge).astype(np.int64)
            for step in itertools.product((-1, 1), repeat=3)
        ]
        return np.unique(kernels.keys_of(np.unique(np.concatenate(corners), axis=0)))

    def _integrate_planes(self, points: Vertices, normals: Vertices, pose: Pose, sign: int) -> None:
        kernels.integrate_planes(
            self.voxels,
            self.keys,
            self.slots,
            np.ascontiguousarray(transform(pose, points)),
            np.ascontiguousarray(normals.astype(np.float64) @ pose[:3, :3].T),
            self.voxel,
            self.truncation,
            sign,
        )

    def _insert(self, keys: NDArray[np.int64]) -> None:
        """Make empty blocks."""
        slots = [self._free.pop() for _ in keys]
        mask = 2 * kernels.HALF_RANGE - 1
        self.blocks[slots] = np.stack([keys >> 42, keys >> 21 & mask, keys & mask], axis=1) - kernels.HALF_RANGE
        self.live[slots] = True
        added = np.zeros_like(self.live)
        added[slots] = True
        kernels.fill_table(self.keys, self.slots, self.blocks, added)

    def _integrate(
        self, keys: NDArray[np.int64], depth: Depth, color: Image, camera: Camera, pose: Pose, sign: int
    ) -> None:
        kernels.integrate(
            self.voxels,
            self.look_up(keys),
            self.blocks,
            depth,
            color,
            np.ascontiguousarray(inverse(pose)),
            _intrinsics(camera),
            self.voxel,
            self.truncation,
            sign,
        )


def without_edges(depth: Depth, furthest: float) -> Depth:
    """Return a depth image without what is too far, and without pixels at edges, which lie between two surfaces.

    Args:
        depth: (height, width) float32, metres, 0 = none.
        furthest: Metres.
    """
    kernel = np.ones((3, 3), np.uint8)
    nearest = cv2.erode(np.where(depth > 0, depth, np.float32(np.inf)), kernel)
    step = cv2.dilate(depth, kernel) - nearest
    good = (depth > 0) & (depth <= furthest) & (step < 0.02 + 0.04 * depth)
    return np.where(good, depth, np.float32(0))


def _intrinsics(camera: Camera) -> NDArray[np.float64]:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy])
