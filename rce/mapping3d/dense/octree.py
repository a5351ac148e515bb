"""Voxels as a file of OctoMap (.bt), which ROS programs read.

Hornung et al., OctoMap: An Efficient Probabilistic 3D Mapping Framework Based on Octrees, 2013.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DEPTH = 16  # levels; the tree covers 2^16 voxels in each direction, with the origin in its middle
FREE, OCCUPIED, INNER = 1, 2, 3  # two bits for each child of a node; 0 is unknown


def octree(centres: NDArray[np.float64], occupied: NDArray[np.bool_], voxel: float) -> bytes:
    """Return the file of an octree.

    Args:
        centres: (n, 3) points in different voxels, metres.
        occupied: (n,) whether each voxel is occupied; the others are free.
        voxel: Edge of a voxel, metres.
    """
    codes, kinds = _leaves(centres, occupied, voxel)
    body, nodes = _body(codes, kinds)
    header = f"# Octomap OcTree binary file\nid OcTree\nsize {nodes}\nres {voxel:g}\ndata\n"
    return header.encode() + body


def _leaves(
    centres: NDArray[np.float64], occupied: NDArray[np.bool_], voxel: float
) -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
    """Return the path (n,) of each voxel from the root, three bits for each level, in order, and its kind."""
    keys = np.floor(centres / voxel).astype(np.int64) + (1 << (DEPTH - 1))
    inside = ((keys >= 0) & (keys < 1 << DEPTH)).all(axis=1)
    keys, kinds = keys[inside], np.where(occupied[inside], OCCUPIED, FREE).astype(np.uint16)
    codes = np.zeros(len(keys), np.int64)
    for level in range(DEPTH):
        for axis in range(3):
            codes |= (keys[:, axis] >> level & 1) << (3 * level + axis)
    order = np.argsort(codes)
    return codes[order], kinds[order]


def _body(codes: NDArray[np.int64], kinds: NDArray[np.uint16]) -> tuple[bytes, int]:
    """Return the inner nodes, two bytes each, every node before its children, and the number of all nodes.

    Sorted by its path and then by its level, a node comes before its children and after its elder siblings' subtrees.
    """
    if not len(codes):
        return b"", 0
    firsts, levels, words = [], [], []
    nodes = 1 + len(codes)
    for level in range(1, DEPTH + 1):
        parents = codes >> 3
        starts = np.flatnonzero(np.diff(parents, prepend=-1))
        shifted = kinds << (2 * (codes & 7)).astype(np.uint16)
        words.append(np.bitwise_or.reduceat(shifted, starts))
        codes, kinds = parents[starts], np.full(len(starts), INNER, np.uint16)
        firsts.append(codes << (3 * level))
        levels.append(np.full(len(codes), -level))
        nodes += len(codes) if level < DEPTH else 0
    order = np.lexsort([np.concatenate(levels), np.concatenate(firsts)])
    return np.concatenate(words)[order].astype("<u2").tobytes(), nodes
