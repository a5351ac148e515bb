"""Clouds and meshes as PLY, binary little endian (Turk, The PLY Polygon File Format, 1994)."""

from __future__ import annotations

import numpy as np

from rce.mapping3d.dense.mesh import Cloud, Mesh
from rce.mapping3d.poses import Pose

VERTEX = np.dtype([("point", "<f4", 3), ("normal", "<f4", 3), ("color", "u1", 3)])
FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
PROPERTIES = [f"float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")] + [
    "uchar red",
    "uchar green",
    "uchar blue",
]


def cloud_ply(cloud: Cloud, level: Pose | None = None) -> bytes:
    """Return the file of a cloud.

    Args:
        cloud: The cloud.
        level: (4, 4) takes its points to the level frame; a comment `level` has its 16 numbers by rows.
    """
    return _header(len(cloud.points), None, level) + _vertices(cloud)


def mesh_ply(mesh: Mesh, level: Pose | None = None) -> bytes:
    """Return the file of a mesh; `level` is as for a cloud."""
    faces = np.empty(len(mesh.triangles), FACE)
    faces["count"], faces["corners"] = 3, mesh.triangles
    return _header(len(mesh.cloud.points), len(faces), level) + _vertices(mesh.cloud) + faces.tobytes()


def _header(vertices: int, faces: int | None, level: Pose | None) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0"]
    if level is not None:
        lines.append(f"comment level {' '.join(f'{each:.6g}' for each in level.ravel())}")
    lines.append(f"element vertex {vertices}")
    lines += [f"property {each}" for each in PROPERTIES]
    if faces is not None:
        lines += [f"element face {faces}", "property list uchar int vertex_indices"]
    return "\n".join([*lines, "end_header", ""]).encode()


def _vertices(cloud: Cloud) -> bytes:
    records = np.empty(len(cloud.points), VERTEX)
    records["point"], records["normal"], records["color"] = cloud.points, cloud.normals, cloud.colors
    return records.tobytes()
