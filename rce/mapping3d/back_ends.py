"""The back end and the dense map of each sensor."""

from __future__ import annotations

from typing import Any

from rce.mapping3d.dense.dense_map import DENSE_CONFIG, LIDAR_CONFIG, DenseMap
from rce.mapping3d.graph.key_frame_mapper import KeyFrameMapper
from rce.mapping3d.graph.mapper import Mapper3d
from rce.mapping3d.lidar.mapper import LidarMapper
from rce.mapping3d.sensors import LIDAR


def back_end(sensor: str) -> KeyFrameMapper[Any]:
    """Return an empty map of the key frames of a sensor."""
    return LidarMapper() if sensor == LIDAR else Mapper3d()


def dense_map(sensor: str) -> DenseMap:
    """Return an empty dense map of what a sensor measures."""
    return DenseMap(LIDAR_CONFIG if sensor == LIDAR else DENSE_CONFIG)
