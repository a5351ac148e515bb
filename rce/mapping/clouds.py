"""Points out of `sensor_msgs/PointCloud2` of any layout of fields."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader

from rce.errors import InvalidRequest

Points = NDArray[np.float32]  # (n, 3), metres, frame of the lidar
CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # of sensor_msgs/PointField
TIMES = ("t", "time", "timestamp", "time_stamp", "timestamps", "offset_time", "time_offset", "stamps")
NANOSECONDS = ("t", "offset_time")  # are nanoseconds where they are integers: Ouster, Livox
LONGEST = 1.0  # seconds of a sweep
UNITS = (1.0, 1e-3, 1e-6, 1e-9)  # seconds: what drivers use for the time of a point


class Stamp(Protocol):
    """`builtin_interfaces/Time`."""

    sec: int
    nanosec: int


class Header(Protocol):
    """`std_msgs/Header`."""

    @property
    def stamp(self) -> Stamp:
        """Time of the message."""


class Field(Protocol):
    """`sensor_msgs/PointField`."""

    name: str
    offset: int
    datatype: int


class PointCloud2(Protocol):
    """`sensor_msgs/PointCloud2`, of rclpy or rosbags."""

    height: int
    width: int
    is_bigendian: bool
    point_step: int
    row_step: int
    data: Any

    @property
    def header(self) -> Header:
        """Time and frame."""

    @property
    def fields(self) -> Sequence[Field]:
        """Layout of a point."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """The points of one message.

    Attributes:
        stamp: Seconds.
        points: (n, 3) float32, metres, frame of the lidar, all finite.
        times: (n,) float64, seconds since the first point; all 0 where the message has none.
    """

    stamp: float
    points: Points
    times: NDArray[np.float64]


def cloud_topic(reader: AnyReader, name: str, topic: str = "") -> str:
    """Return the topic of the clouds in a bag.

    Args:
        reader: The open bag.
        name: Of the bag, for errors.
        topic: The topic that is wanted; empty if there is only one.

    Raises:
        InvalidRequest: There is no such topic, or there are several and none was chosen.
    """
    topics = sorted({each.topic for each in reader.connections if each.msgtype == CLOUD_TYPE and each.msgcount})
    if topic and topic not in topics:
        have = ", ".join(topics) or "none"
        raise InvalidRequest(
            f"{name} has no topic {topic} of type {CLOUD_TYPE}; topics of this type: {have}", field="topic"
        )
    if not topics:
        raise InvalidRequest(f"{name} has no clouds: no messages of type {CLOUD_TYPE}", field="path")
    if not topic and len(topics) > 1:
        raise InvalidRequest(f"{name} has clouds of several lidars: choose one of {', '.join(topics)}", field="topic")
    return topic or topics[0]


def decode(message: PointCloud2, received: int = 0) -> Sweep:
    """Return the points of a message. Those that are not finite, or at the lidar itself, are left out: no return.

    Args:
        message: The message.
        received: Nanoseconds; the stamp if that of the message is 0.

    Raises:
        InvalidRequest: x, y or z is missing, or the data do not fit the layout.
    """
    records = _records(message)
    missing = [axis for axis in "xyz" if axis not in (records.dtype.names or ())]
    if missing:
        raise InvalidRequest(f"the point cloud has no field {', '.join(missing)}", field="fields")
    points = np.stack([records[axis].astype(np.float32) for axis in "xyz"], axis=1)
    good = np.isfinite(points).all(axis=1) & (np.abs(points) > 1e-3).any(axis=1)
    name = next((each for each in TIMES if each in (records.dtype.names or ())), None)
    times = np.zeros(len(points)) if name is None else records[name].astype(np.float64)
    integers = name in NANOSECONDS and records.dtype[name].kind in "iu"
    stamp = (message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec) or 1e-9 * received
    return Sweep(stamp, points[good], _since_first(times[good], UNITS[-1:] if integers else UNITS))


def _records(message: PointCloud2) -> NDArray[np.void]:
    """Return the points (n,) as records of their fields.

    Raises:
        InvalidRequest: The data do not fit the layout.
    """
    order = ">" if message.is_bigendian else "<"
    fields = [field for field in message.fields if field.name in ("x", "y", "z", *TIMES)]
    unknown = [field.name for field in fields if field.datatype not in TYPES]
    if unknown:
        raise InvalidRequest(f"the point cloud has an unknown type in field {', '.join(unknown)}", field="fields")
    formats = [order + TYPES[field.datatype] for field in fields]
    ends = [field.offset + np.dtype(each).itemsize for field, each in zip(fields, formats, strict=True)]
    row = max(message.row_step, message.width * message.point_step)
    used = (message.height - 1) * row + message.width * message.point_step if message.height and message.width else 0
    data = np.frombuffer(bytes(message.data), np.uint8)
    if max(ends, default=0) > message.point_step or len(data) < used:
        raise InvalidRequest(
            f"the point cloud of {message.width}x{message.height} points of {message.point_step} bytes does not fit "
            f"its {len(data)} bytes of data",
            field="data",
        )
    layout = np.dtype(
        {
            "names": [field.name for field in fields],
            "formats": formats,
            "offsets": [field.offset for field in fields],
            "itemsize": message.point_step,
        }
    )
    if not used:
        return np.empty(0, layout)
    data = np.append(data[:used], np.zeros(message.height * row - used, np.uint8))
    rows = data.reshape(message.height, row)[:, : message.width * message.point_step]
    return np.ascontiguousarray(rows).reshape(-1).view(layout)


def _since_first(times: NDArray[np.float64], units: Sequence[float]) -> NDArray[np.float64]:
    """Return times (n,) of any origin, and one of these units, as seconds since the first.

    Drivers disagree: seconds, milliseconds, micro- or nanoseconds, since the beginning of the sweep or of an epoch. The
    largest unit with which the sweep is no longer than a second is the one that was meant.
    """
    if not len(times):
        return times
    since = times - times.min()
    span = float(since.max())
    unit = next((unit for unit in units if span * unit <= LONGEST), 0.0)
    seconds: NDArray[np.float64] = since * unit
    return seconds
