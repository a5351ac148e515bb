from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from builtin_interfaces.msg import Time
from rce_mapping3d import messages
from scipy.spatial.transform import Rotation

from rce.mapping3d.dense.mesh import Cloud
from rce.mapping3d.offload.shared_map import Corrected
from rce.mapping3d.poses import from_quaternion, make_pose
from tests.support.key_frames import right

TURN = make_pose(Rotation.from_euler("z", 90, degrees=True).as_matrix(), (1.0, 2.0, 3.0))


def test_stamps_keep_their_microseconds() -> None:
    stamp = messages.stamp_of(1_700_000_000.123457)
    assert messages.microseconds(stamp) == 1_700_000_000_123_457
    assert messages.seconds(stamp) == pytest.approx(1_700_000_000.123457, abs=1e-6)


def test_pose_has_the_covariance_along_the_axes_of_the_map() -> None:
    message = messages.pose_message(1.5, "map", TURN, np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    assert (message.header.frame_id, message.header.stamp) == ("map", Time(sec=1, nanosec=500_000_000))
    np.testing.assert_allclose(from_quaternion(*messages.pose_from(message.pose.pose)), TURN, atol=1e-9)
    np.testing.assert_allclose(np.reshape(message.pose.covariance, (6, 6)).diagonal(), [2, 1, 3, 5, 4, 6], atol=1e-9)


def test_path_has_the_map_of_each_key_frame() -> None:
    path = messages.path_message("map", [Corrected(0, 1.0, np.eye(4), "map"), Corrected(1, 2.0, right(0.5), "map_7")])
    assert [each.header.frame_id for each in path.poses] == ["map", "map_7"]
    assert path.header.stamp == Time(sec=2)
    assert path.poses[1].pose.position.x == 0.5
    assert messages.path_message("map", []).poses == []


def test_cloud_has_colours_as_pcl_has_them() -> None:
    points = np.array([[1, 2, 3], [4, 5, 6]], np.float32)
    cloud = Cloud(points, np.zeros_like(points), np.array([[255, 128, 1], [0, 0, 0]], np.uint8))
    message = messages.cloud_message(cloud, Time(), "map")
    values = np.frombuffer(message.data, "<f4").reshape(2, 4)
    np.testing.assert_array_equal(values[:, :3], points)
    assert values[:, 3].view("<u4").tolist() == [0xFF8001, 0]
    assert [field.name for field in message.fields] == ["x", "y", "z", "rgb"]


def test_file_arrives_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(messages, "PIECE", 4)
    pieces = list(messages.file_messages("map.pgm", b"0123456789"))
    assert [piece.layout.data_offset for piece in pieces] == [0, 4, 8]
    assert {(piece.layout.dim[0].label, piece.layout.dim[0].size) for piece in pieces} == {("map.pgm", 10)}
    assert b"".join(bytes(piece.data) for piece in pieces) == b"0123456789"
    assert len(list(messages.file_messages("empty", b""))) == 1


def test_compressed_message_carries_bytes() -> None:
    message = messages.compressed_message(1.0, "camera", "rce_key_frame", b"12")
    assert (message.format, bytes(message.data), message.header.stamp.sec) == ("rce_key_frame", b"12", 1)
