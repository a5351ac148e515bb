from __future__ import annotations

import numpy as np

from rce.mapping3d.dense.mesh import Cloud, Mesh
from rce.mapping3d.dense.ply import FACE, VERTEX, cloud_ply, mesh_ply

CLOUD = Cloud(
    np.array([[1, 2, 3], [4, 5, 6], [7, 8, 10]], np.float32),
    np.array([[0, 0, 1]] * 3, np.float32),
    np.array([[255, 0, 1], [2, 3, 4], [5, 6, 7]], np.uint8),
)


def test_cloud_has_a_record_of_27_bytes_for_each_point() -> None:
    header, body = cloud_ply(CLOUD).split(b"end_header\n", 1)
    assert header.decode().splitlines()[:4] == [
        *("ply", "format binary_little_endian 1.0", "element vertex 3", "property float x")
    ]
    records = np.frombuffer(body, VERTEX)
    assert VERTEX.itemsize == 27
    assert records["point"].tolist() == CLOUD.points.tolist()
    assert records["color"].tolist() == CLOUD.colors.tolist()


def test_level_frame_is_a_comment() -> None:
    level = np.arange(16.0).reshape(4, 4)
    header = cloud_ply(CLOUD, level).split(b"end_header\n", 1)[0].decode()
    assert header.splitlines()[2] == f"comment level {' '.join(map(str, range(16)))}"


def test_mesh_ends_with_its_triangles() -> None:
    header, body = mesh_ply(Mesh(CLOUD, np.array([[0, 1, 2]], np.int32))).split(b"end_header\n", 1)
    assert b"element face 1\nproperty list uchar int vertex_indices" in header
    face = np.frombuffer(body[3 * 27 :], FACE)
    assert face["count"].tolist() == [3]
    assert face["corners"].tolist() == [[0, 1, 2]]
