"""Compiled inner loops of the volume: the hash table of blocks, and the integration of depth images.

A block is 8 x 8 x 8 voxels; voxel (x, y, z) of it has the index x + 8 y + 64 z. Voxel (0, 0, 0) of block (0, 0, 0) has
its lowest corner at the origin of the map. A hash table with open addressing finds the slot of a block (Niessner et
al., Real-time 3D Reconstruction at Scale Using Voxel Hashing, 2013). Kernels release the GIL.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rce.mapping.matching.kernels import compiled

SIDE = 8  # voxels along the edge of a block
EMPTY = -1  # key of an unused entry of the table; block (x, y, z) has a key >= 0
UNITS = 2000.0  # of a signed distance as large as the truncation, in the sums
CHANNELS = 5  # of a voxel: sum of distances, sum of weights, sums of red, green and blue
GREY = 190  # of what has no colour
HALF_RANGE = 1 << 20  # block coordinates are -HALF_RANGE to HALF_RANGE - 1


@compiled("int64(int64, int64, int64)")
def key_of(x: int, y: int, z: int) -> int:
    """Return the key of a block."""
    return ((x + HALF_RANGE) << 42) | ((y + HALF_RANGE) << 21) | (z + HALF_RANGE)


def keys_of(blocks: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the keys (n,) of blocks (n, 3)."""
    x, y, z = blocks.T + HALF_RANGE
    keys: NDArray[np.int64] = x << 42 | y << 21 | z
    return keys


@compiled("int64(int64[::1], int64)")
def entry_of(keys: NDArray[np.int64], key: int) -> int:
    """Return the entry of the table that has this key, or the unused one where it would be.

    Args:
        keys: (2^n,), never full.
        key: From `key_of`.
    """
    mask = keys.shape[0] - 1
    mixed = key * np.int64(-7046029254386353131)  # 2^64 divided by the golden ratio
    entry: int = (mixed ^ (mixed >> 29)) & mask
    while keys[entry] != key and keys[entry] != EMPTY:
        entry = (entry + 1) & mask
    return entry


@compiled("void(int64[::1], int32[::1], int32[:,::1], boolean[::1])")
def fill_table(
    keys: NDArray[np.int64], slots: NDArray[np.int32], blocks: NDArray[np.int32], live: NDArray[np.bool_]
) -> None:
    """Write the blocks of the live slots into an empty table.

    Args:
        keys: (2^n,), all `EMPTY`.
        slots: (2^n,), the slot of each entry.
        blocks: (capacity, 3) coordinates of the block in each slot.
        live: (capacity,), true for slots in use.
    """
    for slot in range(blocks.shape[0]):
        if live[slot]:
            key = key_of(blocks[slot, 0], blocks[slot, 1], blocks[slot, 2])
            entry = entry_of(keys, key)
            keys[entry] = key
            slots[entry] = slot


@compiled("void(int64[::1], int32[::1], int64[::1], int64[::1])")
def look_up(
    keys: NDArray[np.int64], slots: NDArray[np.int32], wanted: NDArray[np.int64], found: NDArray[np.int64]
) -> None:
    """Find the slots (n,) of the blocks with the keys `wanted` (n,); -1 where there is none."""
    for i in range(wanted.shape[0]):
        entry = entry_of(keys, wanted[i])
        found[i] = slots[entry] if keys[entry] != EMPTY else -1


@compiled("int64(float32[:,::1], float64[:,::1], float64[::1], float64, float64, int64[::1])")
def find_blocks(
    depth: NDArray[np.float32],
    pose: NDArray[np.float64],
    camera: NDArray[np.float64],
    edge: float,
    truncation: float,
    found: NDArray[np.int64],
) -> int:
    """Find the blocks that the rays of a depth image pass within the truncation around what they hit.

    Args:
        depth: (height, width) metres, 0 = none.
        pose: (4, 4) camera to map.
        camera: fx, fy, cx, cy.
        edge: Of a block, metres.
        truncation: Metres.
        found: (2^n,), all `EMPTY`, a set of keys. It receives the blocks.

    Returns:
        The number of blocks, or -1 if they do not fit.
    """
    count, last = 0, EMPTY
    steps = math.ceil(2.0 * truncation / (0.5 * edge))
    for v in range(0, depth.shape[0], 2):  # neighbours hit the same blocks: every second pixel finds them
        for u in range(0, depth.shape[1], 2):
            d = depth[v, u]
            if d <= 0.0:
                continue
            x, y = (u - camera[2]) / camera[0], (v - camera[3]) / camera[1]
            for step in range(steps + 1):
                z = d - truncation + 2.0 * truncation * step / steps
                cell_x = pose[0, 0] * x * z + pose[0, 1] * y * z + pose[0, 2] * z + pose[0, 3]
                cell_y = pose[1, 0] * x * z + pose[1, 1] * y * z + pose[1, 2] * z + pose[1, 3]
                cell_z = pose[2, 0] * x * z + pose[2, 1] * y * z + pose[2, 2] * z + pose[2, 3]
                key = key_of(math.floor(cell_x / edge), math.floor(cell_y / edge), math.floor(cell_z / edge))
                if key == last:
                    continue
                last = key
                entry = entry_of(found, key)
                if found[entry] == EMPTY:
                    if 2 * count >= found.shape[0]:
                        return -1
                    found[entry] = key
                    count += 1
    return count


@compiled(
    "void(int32[:,:,::1], int64[::1], int32[:,::1], float32[:,::1], uint8[:,:,::1], float64[:,::1], float64[::1], "
    "float64, float64, int64)"
)
def integrate(
    voxels: NDArray[np.int32],
    chosen: NDArray[np.int64],
    blocks: NDArray[np.int32],
    depth: NDArray[np.float32],
    color: NDArray[np.uint8],
    pose: NDArray[np.float64],
    camera: NDArray[np.float64],
    voxel: float,
    truncation: float,
    sign: int,
) -> None:
    """Add a depth image to the sums of some blocks, or take it out (Curless and Levoy, 1996; Dai et al., 2017).

    The sums are integers: what was added is taken out without a remainder. A measurement has the weight 16 / depth^2,
    from 1 to 64, since the deviation of structured light grows with the square of the depth (Khoshelham and Elberink,
    2012).

    Args:
        voxels: (capacity, 512, 5), changed in place.
        chosen: (n,) slots.
        blocks: (capacity, 3) coordinates of the block in each slot.
        depth: (height, width) metres, 0 = none.
        color: (height, width, 3) red, green, blue.
        pose: (4, 4) map to camera.
        camera: fx, fy, cx, cy.
        voxel: Edge, metres.
        truncation: Metres.
        sign: 1 to add, -1 to take out.
    """
    height, width = depth.shape
    for i in range(chosen.shape[0]):
        slot = chosen[i]
        for z in range(SIDE):
            for y in range(SIDE):
                map_x = (blocks[slot, 0] * SIDE + 0.5) * voxel
                map_y = (blocks[slot, 1] * SIDE + y + 0.5) * voxel
                map_z = (blocks[slot, 2] * SIDE + z + 0.5) * voxel
                first = (z * SIDE + y) * SIDE
                base_x = pose[0, 0] * map_x + pose[0, 1] * map_y + pose[0, 2] * map_z + pose[0, 3]
                base_y = pose[1, 0] * map_x + pose[1, 1] * map_y + pose[1, 2] * map_z + pose[1, 3]
                base_z = pose[2, 0] * map_x + pose[2, 1] * map_y + pose[2, 2] * map_z + pose[2, 3]
                for x in range(SIDE):
                    at_z = base_z + pose[2, 0] * voxel * x
                    if at_z < 0.05:
                        continue
                    u = math.floor(camera[0] * (base_x + pose[0, 0] * voxel * x) / at_z + camera[2] + 0.5)
                    v = math.floor(camera[1] * (base_y + pose[1, 0] * voxel * x) / at_z + camera[3] + 0.5)
                    if u < 0 or v < 0 or u >= width or v >= height:
                        continue
                    d = np.float64(depth[v, u])
                    distance = d - at_z
                    if d <= 0.0 or distance < -truncation:
                        continue
                    weight = sign * min(64, max(1, int(16.0 / (d * d) + 0.5)))
                    share = min(1.0, distance / truncation)
                    sums = voxels[slot, first + x]
                    sums[0] += weight * math.floor(UNITS * share + 0.5)
                    sums[1] += weight
                    sums[2] += weight * np.int32(color[v, u, 0])
                    sums[3] += weight * np.int32(color[v, u, 1])
                    sums[4] += weight * np.int32(color[v, u, 2])


@compiled("void(int32[:,:,::1], int64[::1], int32[::1], float64[:,::1], float64[:,::1], float64, float64, int64)")
def integrate_planes(
    voxels: NDArray[np.int32],
    keys: NDArray[np.int64],
    slots: NDArray[np.int32],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    voxel: float,
    truncation: float,
    sign: int,
) -> None:
    """Add points on planes to the sums of the voxels around them, or take them out.

    The distance of a voxel is that from the plane of each point near it, and the weight falls with the distance from
    the point, so that the surface between points is smooth (Kolluri, Provably Good Moving Least Squares, 2005). What is
    further away than the truncation gets nothing.

    Args:
        voxels: (capacity, 512, 5), changed in place.
        keys: (2^n,) of the hash table.
        slots: (2^n,) of the hash table.
        points: (n, 3) metres, frame of the map.
        normals: (n, 3) unit vectors.
        voxel: Edge, metres.
        truncation: Metres.
        sign: 1 to add, -1 to take out.
    """
    reach = math.ceil(truncation / voxel)
    for i in range(points.shape[0]):
        x = math.floor(points[i, 0] / voxel)
        y = math.floor(points[i, 1] / voxel)
        z = math.floor(points[i, 2] / voxel)
        last, slot = EMPTY, -1
        for c in range(z - reach, z + reach + 1):
            for b in range(y - reach, y + reach + 1):
                for a in range(x - reach, x + reach + 1):
                    off_x = (a + 0.5) * voxel - points[i, 0]
                    off_y = (b + 0.5) * voxel - points[i, 1]
                    off_z = (c + 0.5) * voxel - points[i, 2]
                    square = off_x * off_x + off_y * off_y + off_z * off_z
                    if square > truncation * truncation:
                        continue
                    distance = off_x * normals[i, 0] + off_y * normals[i, 1] + off_z * normals[i, 2]
                    key = key_of(a >> 3, b >> 3, c >> 3)
                    if key != last:
                        last = key
                        entry = entry_of(keys, key)
                        slot = slots[entry] if keys[entry] != EMPTY else -1
                    if slot < 0:
                        continue
                    weight = sign * (1 + int(15.0 * (1.0 - square / (truncation * truncation))))
                    sums = voxels[slot, (a & 7) + 8 * (b & 7) + 64 * (c & 7)]
                    sums[0] += weight * math.floor(UNITS * distance / truncation + 0.5)
                    sums[1] += weight
                    for k in range(2, CHANNELS):
                        sums[k] += weight * GREY


@compiled("void(int32[:,:,::1], boolean[::1])")
def drop_unseen(voxels: NDArray[np.int32], live: NDArray[np.bool_]) -> None:
    """Set `live` (capacity,) to false for the blocks that no measurement is left in."""
    for slot in range(live.shape[0]):
        if live[slot]:
            seen = False
            for i in range(voxels.shape[1]):
                if voxels[slot, i, 1] != 0:
                    seen = True
                    break
            live[slot] = seen
