"""Clouds and meshes as PLY, binary little endian (Turk, The PLY Polygon File Format, 1994)."""

from __future__ import annotations

import numpy as np

from rce.mapping3d.dense.mesh import Cloud, Mesh

VERTEX = np.dtype([("point", "<f4", 3), ("normal", "<f4", 3), ("color", "u1", 3)])
FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
PROPERTIES = [f"float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")] + [
    "uchar red",
    "uchar green",
    "uchar blue",
]


def cloud_ply(cloud: Cloud) -> bytes:
    """Return the file of a cloud."""
    return _header(len(cloud.points), None) + _vertices(cloud)


def mesh_ply(mesh: Mesh) -> bytes:
    """Return the file of a mesh."""
    faces = np.empty(len(mesh.triangles), FACE)
    faces["count"], faces["corners"] = 3, mesh.triangles
    return _header(len(mesh.cloud.points), len(faces)) + _vertices(mesh.cloud) + faces.tobytes()


def _header(vertices: int, faces: int | None) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {vertices}"]
    lines += [f"property {each}" for each in PROPERTIES]
    if faces is not None:
        lines += [f"element face {faces}", "property list uchar int vertex_indices"]
    return "\n".join([*lines, "end_header", ""]).encode()


def _vertices(cloud: Cloud) -> bytes:
    records = np.empty(len(cloud.points), VERTEX)
    records["point"], records["normal"], records["color"] = cloud.points, cloud.normals, cloud.colors
    return records.tobytes()
