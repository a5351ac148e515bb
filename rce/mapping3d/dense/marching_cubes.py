"""The surface of a volume as triangles.

Lorensen and Cline, Marching Cubes: A High Resolution 3D Surface Construction Algorithm, 1987. The table of the 256
cases is computed: on each face of a cube every run of inside corners is cut off by one segment. Neighbouring cubes see
the same corners on their common face and so agree on ambiguous ones, which leaves no holes.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from rce.mapping.matching.kernels import compiled
from rce.mapping3d.dense import kernels
from rce.mapping3d.dense.mesh import Cloud, Mesh
from rce.mapping3d.dense.volume import Volume

SIDE = kernels.SIDE
SIZE = SIDE**3
# Corner c of a cube is at x = c & 1, y = c >> 1 & 1, z = c >> 2. The corners of a face run
# counter-clockwise, seen from outside.
FACES = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))
# An edge is its lower corner and its axis.
EDGES = [(corner, axis) for axis in range(3) for corner in range(8) if not corner >> axis & 1]


def _triangles_of(case: int) -> list[int]:
    """Return three edges for each triangle of a case, whose bit c says whether corner c is inside."""
    following: dict[int, int] = {}
    for face in FACES:
        inside = [bool(case >> corner & 1) for corner in face]
        for k in range(4):
            if inside[k] and not inside[k - 1]:  # a run of inside corners begins
                end = k
                while inside[(end + 1) % 4]:
                    end += 1
                entered = _edge(face[k - 1], face[k])
                following[entered] = _edge(face[end % 4], face[(end + 1) % 4])
    triangles = []
    while following:
        loop = [next(iter(following))]
        while (after := following.pop(loop[-1])) != loop[0]:
            loop.append(after)
        for second, third in itertools.pairwise(loop[1:]):
            triangles += [loop[0], second, third]
    return triangles


def _edge(first: int, second: int) -> int:
    low, axis = min(first, second), (first ^ second).bit_length() - 1
    return EDGES.index((low, axis))


def _table() -> NDArray[np.int64]:
    """Return (256, n): the edges of the triangles of each case, filled up with -1."""
    rows = [_triangles_of(case) for case in range(256)]
    table = np.full((256, max(map(len, rows)) + 1), -1, np.int64)
    for row, edges in zip(table, rows, strict=True):
        row[: len(edges)] = edges
    return table


TABLE = _table()
EDGE_TABLE = np.array(EDGES, np.int64)


def extract(volume: Volume) -> Mesh:
    """Return the surface of a volume: where the signed distance is zero between voxels that were seen."""
    active = np.flatnonzero(volume.live)
    around = _neighbours(volume, active)
    crossings = np.full((len(active) + 1, SIZE, 3), -1, np.int32)  # number of the vertex on each edge of each voxel
    count = number_crossings(volume.voxels, active, around, crossings)
    points, colors = np.empty((count, 3), np.float32), np.empty((count, 3), np.uint8)
    place_vertices(volume.voxels, active, around, volume.blocks, crossings, volume.voxel, points, colors)
    nothing = np.empty((0, 3), np.int32)
    triangles = np.empty((connect(volume.voxels, active, around, crossings, TABLE, EDGE_TABLE, nothing), 3), np.int32)
    connect(volume.voxels, active, around, crossings, TABLE, EDGE_TABLE, triangles)
    normals = np.zeros((count, 3), np.float32)
    add_normals(points, triangles, normals)
    return Mesh(Cloud(points, normals, colors), triangles)


def _neighbours(volume: Volume, active: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (n, 8): the place in `active` of the block at offset (b & 1, b >> 1 & 1, b >> 2) of each, or -1."""
    place = np.full(len(volume.live) + 1, -1, np.int64)  # the last is for slot -1, a missing block
    place[active] = np.arange(len(active))
    around = np.empty((len(active), 8), np.int64)
    for b in range(8):
        blocks = volume.blocks[active].astype(np.int64) + np.array([b & 1, b >> 1 & 1, b >> 2])
        around[:, b] = place[volume.look_up(kernels.keys_of(blocks))]
    return around


@compiled("float64(int32[:,:,::1], int64[::1], int64[:,::1], int64, int64, int64, int64)")
def _distance(
    voxels: NDArray[np.int32],
    active: NDArray[np.int64],
    around: NDArray[np.int64],
    i: int,
    x: int,
    y: int,
    z: int,
) -> float:
    """Return the signed distance, truncation = 1, at voxel (x, y, z), 0 to 8, of active block i; NaN if not seen."""
    block = around[i, (x >> 3) | (y >> 3) << 1 | (z >> 3) << 2]
    if block < 0:
        return np.nan
    index = (x & 7) | (y & 7) << 3 | (z & 7) << 6
    sums = voxels[active[block], index]
    return sums[0] / (kernels.UNITS * sums[1]) if sums[1] > 0 else np.nan


@compiled("int64(int32[:,:,::1], int64[::1], int64[:,::1], int32[:,:,::1])")
def number_crossings(
    voxels: NDArray[np.int32], active: NDArray[np.int64], around: NDArray[np.int64], crossings: NDArray[np.int32]
) -> int:
    """Number the edges on which the distance changes its sign, in `crossings` (n + 1, 512, 3); return how many."""
    count = 0
    for i in range(active.shape[0]):
        for index in range(SIZE):
            x, y, z = index & 7, index >> 3 & 7, index >> 6
            here = _distance(voxels, active, around, i, x, y, z)
            if np.isnan(here):
                continue
            for axis in range(3):
                there = _distance(voxels, active, around, i, x + (axis == 0), y + (axis == 1), z + (axis == 2))
                if not np.isnan(there) and (here < 0.0) != (there < 0.0):
                    crossings[i, index, axis] = count
                    count += 1
    return count


@compiled(
    "void(int32[:,:,::1], int64[::1], int64[:,::1], int32[:,::1], int32[:,:,::1], float64, float32[:,::1], "
    "uint8[:,::1])"
)
def place_vertices(
    voxels: NDArray[np.int32],
    active: NDArray[np.int64],
    around: NDArray[np.int64],
    blocks: NDArray[np.int32],
    crossings: NDArray[np.int32],
    voxel: float,
    points: NDArray[np.float32],
    colors: NDArray[np.uint8],
) -> None:
    """Write the point (count, 3), metres, and the colour (count, 3) of each crossing, linear between its voxels."""
    for i in range(active.shape[0]):
        for index in range(SIZE):
            for axis in range(3):
                vertex = crossings[i, index, axis]
                if vertex < 0:
                    continue
                x, y, z = index & 7, index >> 3 & 7, index >> 6
                far_x, far_y, far_z = x + (axis == 0), y + (axis == 1), z + (axis == 2)
                here = _distance(voxels, active, around, i, x, y, z)
                share = here / (here - _distance(voxels, active, around, i, far_x, far_y, far_z))
                block = blocks[active[i]]
                points[vertex, 0] = (block[0] * SIDE + x + 0.5 + share * (axis == 0)) * voxel
                points[vertex, 1] = (block[1] * SIDE + y + 0.5 + share * (axis == 1)) * voxel
                points[vertex, 2] = (block[2] * SIDE + z + 0.5 + share * (axis == 2)) * voxel
                other = active[around[i, (far_x >> 3) | (far_y >> 3) << 1 | (far_z >> 3) << 2]]
                near = voxels[active[i], index]
                far = voxels[other, (far_x & 7) | (far_y & 7) << 3 | (far_z & 7) << 6]
                for c in range(3):
                    value = (1.0 - share) * near[2 + c] / near[1] + share * far[2 + c] / far[1]
                    colors[vertex, c] = np.uint8(value + 0.5)


@compiled("int64(int32[:,:,::1], int64[::1], int64[:,::1], int32[:,:,::1], int64[:,::1], int64[:,::1], int32[:,::1])")
def connect(
    voxels: NDArray[np.int32],
    active: NDArray[np.int64],
    around: NDArray[np.int64],
    crossings: NDArray[np.int32],
    table: NDArray[np.int64],
    edges: NDArray[np.int64],
    triangles: NDArray[np.int32],
) -> int:
    """Write the triangles (m, 3) of all cubes whose corners were seen; return their number.

    With an empty array only the number is found.
    """
    count = 0
    for i in range(active.shape[0]):
        for index in range(SIZE):
            x, y, z = index & 7, index >> 3 & 7, index >> 6
            case = 0
            for c in range(8):
                value = _distance(voxels, active, around, i, x + (c & 1), y + (c >> 1 & 1), z + (c >> 2))
                if np.isnan(value):
                    case = 0
                    break
                case |= (value < 0.0) << c
            k = 0
            while table[case, k] >= 0:
                if triangles.shape[0]:
                    for corner in range(3):
                        low, axis = edges[table[case, k + corner]]
                        at_x, at_y, at_z = x + (low & 1), y + (low >> 1 & 1), z + (low >> 2)
                        block = around[i, (at_x >> 3) | (at_y >> 3) << 1 | (at_z >> 3) << 2]
                        triangles[count, corner] = crossings[
                            block, (at_x & 7) | (at_y & 7) << 3 | (at_z & 7) << 6, axis
                        ]
                count += 1
                k += 3
    return count


@compiled("void(float32[:,::1], int32[:,::1], float32[:,::1])")
def add_normals(points: NDArray[np.float32], triangles: NDArray[np.int32], normals: NDArray[np.float32]) -> None:
    """Set the normals (n, 3) of points to the mean of their triangles' (m, 3), weighted by area, of unit length."""
    for m in range(triangles.shape[0]):
        a, b, c = triangles[m]
        first, second = points[b] - points[a], points[c] - points[a]
        for k in range(3):
            j, h = (k + 1) % 3, (k + 2) % 3
            value = first[j] * second[h] - first[h] * second[j]
            normals[a, k] += value
            normals[b, k] += value
            normals[c, k] += value
    for i in range(normals.shape[0]):
        length = np.sqrt(normals[i, 0] ** 2 + normals[i, 1] ** 2 + normals[i, 2] ** 2)
        if length > 0.0:
            for k in range(3):
                normals[i, k] /= length
