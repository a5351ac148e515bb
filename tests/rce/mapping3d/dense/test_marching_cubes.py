from __future__ import annotations

from collections import Counter

import numpy as np

from rce.mapping3d.dense import kernels
from rce.mapping3d.dense.marching_cubes import EDGES, TABLE, extract
from rce.mapping3d.dense.volume import Volume

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
VOXEL, TRUNCATION = 0.05, 0.15


def filled(distance: Array, corner: int) -> Volume:
    """Return a volume with the distances (8 n, 8 n, 8 n), x first, of blocks from `corner` on in all directions."""
    count = distance.shape[0] // 8
    places = np.stack(np.meshgrid(*[np.arange(count)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    volume = Volume(VOXEL, TRUNCATION, len(places))
    volume.blocks[:], volume.live[:] = places + corner, True
    kernels.fill_table(volume.keys, volume.slots, volume.blocks, volume.live)
    for slot, (x, y, z) in enumerate((8 * places).tolist()):
        part = distance[x : x + 8, y : y + 8, z : z + 8].transpose(2, 1, 0).reshape(-1)
        volume.voxels[slot, :, 0] = np.rint(np.clip(part / TRUNCATION, -1, 1) * kernels.UNITS)
        volume.voxels[slot, :, 1:] = [1, 10, 20, 30]
    return volume


def sphere(radius: float) -> Volume:
    centres = (np.arange(-16, 16) + 0.5) * VOXEL
    x, y, z = np.meshgrid(centres, centres, centres, indexing="ij")
    return filled(np.sqrt(x**2 + y**2 + z**2) - radius, -2)


def test_table_uses_exactly_the_edges_that_are_cut() -> None:
    for case, row in enumerate(TABLE.tolist()):
        cut = {k for k, (low, axis) in enumerate(EDGES) if (case >> low & 1) != (case >> (low | 1 << axis) & 1)}
        assert {edge for edge in row if edge >= 0} == cut


def test_sphere_is_closed_round_and_faces_outwards() -> None:
    mesh = extract(sphere(0.6))
    points, triangles = mesh.cloud.points.astype(np.float64), mesh.triangles
    sides = Counter((int(a), int(b)) for each in triangles for a, b in zip(each, np.roll(each, -1), strict=True))
    assert all(count == 1 and sides[b, a] == 1 for (a, b), count in sides.items())
    assert len(points) - len(sides) // 2 + len(triangles) == 2  # Euler's formula
    assert np.abs(np.linalg.norm(points, axis=1) - 0.6).max() < 0.004
    assert (np.sum(points * mesh.cloud.normals, axis=1) > 0.59).all()
    corners = points[triangles]
    volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert abs(volume / (4 / 3 * np.pi * 0.6**3) - 1) < 0.02


def test_random_distances_give_a_surface_without_holes() -> None:
    noise = np.random.default_rng(2).uniform(-0.1, 0.1, (16, 16, 16))
    noise[[0, -1]] = noise[:, [0, -1]] = noise[:, :, [0, -1]] = 0.1  # closed at the border
    triangles = extract(filled(noise, -1)).triangles
    sides = Counter((int(a), int(b)) for each in triangles for a, b in zip(each, np.roll(each, -1), strict=True))
    assert all(count == sides[b, a] for (a, b), count in sides.items())


def test_colours_are_those_of_the_voxels() -> None:
    assert (extract(sphere(0.6)).cloud.colors == [10, 20, 30]).all()


def test_there_is_no_surface_where_nothing_was_seen() -> None:
    volume = sphere(0.6)
    volume.voxels[volume.blocks[:, 0] >= 0] = 0
    mesh = extract(volume)
    assert mesh.cloud.points[:, 0].max() < 0
    assert len(mesh.triangles)


def test_empty_volume_has_an_empty_surface() -> None:
    mesh = extract(Volume(VOXEL, TRUNCATION, 10))
    assert mesh.cloud.points.shape == mesh.triangles.shape == (0, 3)
