"""Key frames as they travel from a robot to the cloud."""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera
from rce.mapping3d.graph.state import NO_CAMERA
from rce.mapping3d.graph.store import Packed, pack, unpack, unpack_cloud
from rce.mapping3d.odometry.tracker import Tracked

Floats = NDArray[np.float64]

FORMAT = "rce_key_frame"  # of a `sensor_msgs/CompressedImage` that carries one
MAX_SIDE = 1024  # pixels
POSE, INFORMATION = "<f8", "<f4"


class KeyFrameMessage(msgspec.Struct, array_like=True, frozen=True):
    """A key frame with its motion since an earlier one.

    Attributes:
        run: Name of the life of the robot's front end: a front end that starts anew counts from 0 again.
        index: Number among the key frames of this run, from 0.
        reference: Index of the key frame to which `pose` refers.
        linked: False if `pose` is a guess: the front end began, or had lost track.
        stamp: Seconds.
        pose: (4, 4) float64, little endian, camera of this key frame to camera of the reference.
        information: (6, 6) float32, little endian, inverse covariance of `pose`: translation, rotation, frame of this
            camera.
        camera: width, height, fx, fy, cx, cy; pixels; all 0 for a lidar.
        color: JPEG.
        depth: PNG of 16 bits, quarters of a millimetre, 0 = none.
        cloud: Points of a lidar (`rce.mapping3d.lidar.packing`), in place of camera and images.
    """

    run: str
    index: int
    reference: int
    linked: bool
    stamp: float
    pose: bytes
    information: bytes
    camera: tuple[int, int, float, float, float, float]
    color: bytes
    depth: bytes
    cloud: bytes = b""


def message_of(run: str, tracked: Tracked) -> KeyFrameMessage:
    """Return the message with the key frame of an answer of a front end, which must have one."""
    assert tracked.key is not None
    packed = pack(tracked.key)
    return KeyFrameMessage(
        run,
        packed.index,
        tracked.reference,
        tracked.linked,
        float(packed.stamp),
        tracked.pose.astype(POSE).tobytes(),
        tracked.information.astype(INFORMATION).tobytes(),
        packed.camera.numbers if packed.camera else NO_CAMERA,
        packed.color,
        packed.depth,
        packed.cloud,
    )


def encode(message: KeyFrameMessage) -> bytes:
    """Return a message as bytes (MessagePack)."""
    return msgspec.msgpack.encode(message)


def decode(data: bytes) -> KeyFrameMessage:
    """Return a message from bytes.

    Raises:
        InvalidRequest: They are not a key frame, or its numbers make no sense.
    """
    try:
        message = msgspec.msgpack.decode(data, type=KeyFrameMessage)
    except msgspec.MsgspecError as error:
        raise InvalidRequest(f"this is not a key frame: {error}") from None
    width, height, fx, fy, *_ = message.camera
    fits = len(message.pose) == 16 * 8 and len(message.information) == 36 * 4
    camera = 0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE and fx > 0 and fy > 0
    lidar = bool(message.cloud) and message.camera == NO_CAMERA
    if not fits or not (camera or lidar):
        raise InvalidRequest(f"key frame {message.index} is damaged: its camera, pose or information makes no sense")
    numbers = (message.stamp, *message.camera, *np.frombuffer(message.pose, POSE).tolist())
    if not all(map(math.isfinite, numbers)) or not np.isfinite(np.frombuffer(message.information, INFORMATION)).all():
        raise InvalidRequest(f"key frame {message.index} is damaged: it has numbers that are not finite")
    return message


def pose_of(message: KeyFrameMessage) -> Floats:
    """Return the pose (4, 4) of a message."""
    return np.frombuffer(message.pose, POSE).reshape(4, 4).astype(np.float64)


def information_of(message: KeyFrameMessage) -> Floats:
    """Return the information (6, 6) of a message."""
    return np.frombuffer(message.information, INFORMATION).reshape(6, 6).astype(np.float64)


def unpacked(message: KeyFrameMessage, robot: int) -> tuple[Tracked, Packed]:
    """Return a message as the back end takes it, for the robot of this number.

    Raises:
        InvalidRequest: The images are damaged.
    """
    camera = Camera(*message.camera) if message.camera != NO_CAMERA else None
    packed = Packed(robot, message.index, message.stamp, camera, message.color, message.depth, message.cloud)
    key = unpack(packed) if camera else unpack_cloud(packed)
    tracked = Tracked(
        message.stamp,
        message.reference,
        pose_of(message),
        information_of(message),
        key=key,
        linked=message.linked,
    )
    return tracked, packed


def rebased(message: KeyFrameMessage, before: KeyFrameMessage, information: Floats) -> KeyFrameMessage:
    """Return a message whose pose refers to the reference of the key frame before it, which is left out.

    Args:
        message: The message.
        before: The key frame to which its pose refers.
        information: (6, 6) inverse covariance of both motions together.
    """
    pose = pose_of(before) @ pose_of(message)
    return msgspec.structs.replace(
        message,
        reference=before.reference,
        pose=pose.astype(POSE).tobytes(),
        information=information.astype(INFORMATION).tobytes(),
    )


def unlinked(message: KeyFrameMessage) -> KeyFrameMessage:
    """Return a message whose pose counts as a guess."""
    return msgspec.structs.replace(message, linked=False)
