"""Recordings of cameras with depth, written from the simulated room."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from rce.mapping3d.camera import Camera
from rce.mapping3d.evaluation.room import QVGA, Faults, SimulatedRecording, sweep
from rce.mapping3d.frames import RgbdFrame

CLEAN = Faults(noise=0.0, depth_noise=0.0, missing=0.0)
Message = Any


def simulated(seconds: float = 0.2, speed: float = 1.0, faults: Faults | None = None) -> SimulatedRecording:
    return SimulatedRecording("simulated", sweep(seconds, speed), faults or Faults())


def write_tum(directory: Path, frames: list[RgbdFrame]) -> Path:
    directory.mkdir()
    for number, frame in enumerate(frames):
        cv2.imwrite(str(directory / f"c{number}.png"), cv2.cvtColor(frame.color, cv2.COLOR_RGB2BGR))
        cv2.imwrite(str(directory / f"d{number}.png"), np.round(frame.depth * 5000).astype(np.uint16))
    colors = "".join(f"{frame.stamp:.6f} c{number}.png\n" for number, frame in enumerate(frames))
    depths = "".join(f"{frame.stamp + 0.004:.6f} d{number}.png\n" for number, frame in enumerate(frames))
    (directory / "rgb.txt").write_text("# color images\n" + colors)
    (directory / "depth.txt").write_text("# depth maps\n" + depths)
    return directory


def write_seven_scenes(directory: Path, frames: list[RgbdFrame], camera: Camera = QVGA) -> Path:
    directory.mkdir()
    for number, frame in enumerate(frames):
        name = str(directory / f"frame-{number:06d}")
        cv2.imwrite(f"{name}.color.png", cv2.cvtColor(frame.color, cv2.COLOR_RGB2BGR))
        cv2.imwrite(f"{name}.depth.png", np.where(frame.depth > 0, frame.depth * 1000, 65535).astype(np.uint16))
    np.savetxt(directory / "camera-intrinsics.txt", camera.matrix)
    return directory


class RgbdMessages:
    """Messages of a camera with depth."""

    def __init__(self, kind: Stores) -> None:
        self.store = get_typestore(kind)
        self.ros1 = kind is Stores.ROS1_NOETIC

    def make(self, kind: str, *values: object) -> Message:
        return self.store.types[kind](*values)

    def header(self, stamp: float) -> Message:
        time = self.make("builtin_interfaces/msg/Time", int(stamp), round(stamp % 1 * 1e9))
        return self.make("std_msgs/msg/Header", *((0,) if self.ros1 else ()), time, "camera")

    def image(self, stamp: float, encoding: str, pixels: np.ndarray[Any, Any]) -> Message:
        height, width = pixels.shape[:2]
        data = np.frombuffer(pixels.tobytes(), np.uint8)
        return self.make(
            "sensor_msgs/msg/Image", self.header(stamp), height, width, encoding, 0, len(data) // height, data
        )

    def info(self, stamp: float, camera: Camera) -> Message:
        region = self.make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        projection = np.hstack([camera.matrix, np.zeros((3, 1))]).ravel()
        return self.make(
            "sensor_msgs/msg/CameraInfo",
            self.header(stamp),
            camera.height,
            camera.width,
            "plumb_bob",
            np.zeros(5),
            camera.matrix.ravel(),
            np.eye(3).ravel(),
            projection,
            0,
            0,
            region,
        )

    def of(self, frames: list[RgbdFrame], camera: Camera) -> list[tuple[str, float, Message]]:
        found: list[tuple[str, float, Message]] = []
        for frame in frames:
            stamp = frame.stamp + 1.0
            depth = np.round(frame.depth * 1000).astype(np.uint16)
            found.append(("/camera/color/camera_info", stamp, self.info(stamp, camera)))
            found.append(("/camera/color/image_raw", stamp, self.image(stamp, "bgr8", frame.color[:, :, ::-1])))
            aligned = "/camera/aligned_depth_to_color/image_raw"
            found.append((aligned, stamp + 0.005, self.image(stamp + 0.005, "16UC1", depth)))
        return found


def write_bag1(directory: Path, frames: list[RgbdFrame]) -> Path:
    messages, path = RgbdMessages(Stores.ROS1_NOETIC), directory / "camera.bag"
    with rosbag1.Writer(path) as writer:
        connections: dict[str, Any] = {}
        for topic, stamp, message in messages.of(frames, QVGA):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
            writer.write(connections[topic], round(stamp * 1e9), messages.store.serialize_ros1(message, kind))
    return path


def write_bag2(directory: Path, frames: list[RgbdFrame]) -> Path:
    messages, path = RgbdMessages(Stores.ROS2_HUMBLE), directory / "bag"
    with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for topic, stamp, message in messages.of(frames, QVGA):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
            writer.write(connections[topic], round(stamp * 1e9), messages.store.serialize_cdr(message, kind))
    return path


BAGS: dict[str, Callable[[Path, list[RgbdFrame]], Path]] = {"ros1": write_bag1, "ros2": write_bag2}
