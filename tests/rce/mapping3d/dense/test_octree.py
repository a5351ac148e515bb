from __future__ import annotations

import numpy as np

from rce.mapping3d.dense.octree import octree

Voxel = tuple[int, int, int]


def read(file: bytes) -> tuple[dict[Voxel, bool], int]:
    """Return the voxels of a file, true for occupied ones, and its number of nodes, as OctoMap reads it."""
    header, body = file.split(b"data\n", 1)
    words = iter(np.frombuffer(body, "<u2").tolist())
    voxels: dict[Voxel, bool] = {}
    nodes = 1

    def node(corner: Voxel, size: int) -> None:
        nonlocal nodes
        word, half = next(words), size // 2
        children = [(child, word >> 2 * child & 3) for child in range(8)]
        inner = []
        for child, kind in children:
            at = (corner[0] + half * (child & 1), corner[1] + half * (child >> 1 & 1), corner[2] + half * (child >> 2))
            nodes += kind != 0
            if kind == 3:
                inner.append(at)
            elif kind:
                assert half == 1
                voxels[at] = kind == 2
        for at in inner:
            node(at, half)

    node((-32768, -32768, -32768), 65536)
    assert next(words, None) is None
    assert f"size {nodes}\n".encode() in header
    return voxels, nodes


def test_reader_finds_the_voxels_that_were_written() -> None:
    generator = np.random.default_rng(3)
    keys = np.unique(generator.integers(-40, 40, (300, 3)), axis=0)
    occupied = generator.random(len(keys)) < 0.5
    voxels, _ = read(octree((keys + 0.5) * 0.02, occupied, 0.02))
    assert voxels == {(int(x), int(y), int(z)): bool(o) for (x, y, z), o in zip(keys, occupied, strict=True)}


def test_header_names_the_resolution() -> None:
    file = octree(np.array([[0.1, 0.1, 0.1]]), np.array([True]), 0.05)
    assert file.startswith(b"# Octomap OcTree binary file\nid OcTree\nsize 17\nres 0.05\ndata\n")


def test_tree_without_voxels_has_no_nodes() -> None:
    assert octree(np.empty((0, 3)), np.empty(0, np.bool_), 0.05).endswith(b"size 0\nres 0.05\ndata\n")
