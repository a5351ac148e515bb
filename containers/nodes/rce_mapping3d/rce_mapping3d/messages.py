"""Conversion between ROS messages and the types of `rce.mapping3d`."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Path
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, PointCloud2, PointField
from std_msgs.msg import MultiArrayDimension, UInt8MultiArray

from rce.mapping3d.dense.mesh import Cloud, Mesh
from rce.mapping3d.dense.ply import mesh_ply
from rce.mapping3d.offload.shared_map import Corrected
from rce.mapping3d.poses import Pose, to_quaternion

PIECE = 4 << 20  # bytes of a file in one message
FIELDS = ("x", "y", "z", "rgb")  # of a cloud, 4 bytes each
MESH = "mesh.ply"
NANO = 1_000_000_000


def stamp_of(seconds: float) -> Time:
    """Convert seconds to a stamp, rounded to microseconds."""
    microseconds = round(seconds * 1e6)
    return Time(sec=microseconds // 10**6, nanosec=microseconds % 10**6 * 1000)


def fill_pose(message: PoseMessage, pose: Pose) -> None:
    """Set a pose message to a pose (4, 4)."""
    message.position.x, message.position.y, message.position.z = pose[:3, 3].tolist()
    x, y, z, w = to_quaternion(pose).tolist()
    message.orientation.x, message.orientation.y, message.orientation.z, message.orientation.w = x, y, z, w


def pose_message(stamp: float, frame: str, pose: Pose, covariance: NDArray[np.float64]) -> PoseWithCovarianceStamped:
    """Return the pose of a camera or lidar.

    Args:
        stamp: Seconds.
        frame: Of the map.
        pose: (4, 4) sensor to the map.
        covariance: (6, 6) translation, rotation, frame of the sensor; ROS has those of the axes of the map.
    """
    message = PoseWithCovarianceStamped()
    message.header.stamp, message.header.frame_id = stamp_of(stamp), frame
    fill_pose(message.pose.pose, pose)
    turn = np.kron(np.eye(2), pose[:3, :3])
    message.pose.covariance = (turn @ covariance @ turn.T).ravel()
    return message


def path_message(frame: str, poses: Iterable[Corrected]) -> Path:
    """Return key frames as a path. Each has the frame of its own map."""
    message = Path()
    message.header.frame_id = frame
    found = []
    for each in poses:
        stamped = PoseStamped()
        stamped.header.stamp, stamped.header.frame_id = stamp_of(each.stamp), each.map
        fill_pose(stamped.pose, each.pose)
        found.append(stamped)
    message.poses = found
    if found:
        message.header.stamp = found[-1].header.stamp
    return message


def cloud_message(cloud: Cloud, stamp: Time, frame: str) -> PointCloud2:
    """Return a cloud with fields x, y, z and rgb, float32 each; rgb has the bits 0x00RRGGBB, as PCL has them."""
    message = PointCloud2()
    message.header.stamp, message.header.frame_id = stamp, frame
    message.height, message.width = 1, len(cloud.points)
    message.fields = [
        PointField(name=name, offset=4 * place, datatype=PointField.FLOAT32, count=1)
        for place, name in enumerate(FIELDS)
    ]
    message.point_step, message.row_step, message.is_dense = 16, 16 * len(cloud.points), True
    values = np.empty((len(cloud.points), 4), "<f4")
    values[:, :3] = cloud.points
    colors = cloud.colors.astype(np.uint32)
    values[:, 3] = (colors[:, 0] << 16 | colors[:, 1] << 8 | colors[:, 2]).astype("<u4").view("<f4")
    message.data = array("B", values.tobytes())
    return message


def mesh_message(mesh: Mesh) -> UInt8MultiArray:
    """Return a surface as the bytes of a PLY file: the label is `mesh.ply`."""
    content = mesh_ply(mesh)
    message = UInt8MultiArray()
    message.layout.dim = [MultiArrayDimension(label=MESH, size=len(content), stride=len(content))]
    message.data = array("B", content)
    return message


def file_messages(name: str, content: bytes) -> Iterator[UInt8MultiArray]:
    """Yield the pieces of a file: the label is its name, the size that of the whole, `data_offset` the place in it."""
    for begin in range(0, max(len(content), 1), PIECE):
        message = UInt8MultiArray()
        message.layout.dim = [MultiArrayDimension(label=name, size=len(content), stride=len(content))]
        message.layout.data_offset = begin
        message.data = array("B", content[begin : begin + PIECE])
        yield message


def compressed_message(stamp: float, frame: str, format: str, data: bytes) -> CompressedImage:
    """Return a message that carries bytes of a format."""
    message = CompressedImage(format=format)
    message.header.stamp, message.header.frame_id = stamp_of(stamp), frame
    message.data = array("B", data)
    return message


def seconds(stamp: Time) -> float:
    """Convert a stamp to seconds."""
    return float(stamp.sec + stamp.nanosec / NANO)


def microseconds(stamp: Time) -> int:
    """Convert a stamp to microseconds, the precision of stamps that return."""
    return int(stamp.sec * NANO + stamp.nanosec + 500) // 1000


def pose_from(message: PoseMessage) -> tuple[Sequence[float], Sequence[float]]:
    """Return the translation (3,) and the quaternion (4,) x, y, z, w of a pose."""
    place, turn = message.position, message.orientation
    return (place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w)
