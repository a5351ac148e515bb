"""Sweeps of a lidar: simulated, as messages, and in bags."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags import rosbag2
from rosbags.typesys import Stores, get_typestore

from rce.mapping.clouds import Sweep
from rce.mapping3d.evaluation.building import ROUND, Pattern, SimulatedSweeps, patrol


def message(sweep: Sweep, layout: str = "f4", time: tuple[str, str, float] | None = None, **changes: Any) -> Any:
    """Return a sweep as `sensor_msgs/PointCloud2`.

    Args:
        sweep: The points.
        layout: Type of x, y and z.
        time: Name, type and unit in seconds of the time of each point; None for none.
        changes: Other values of attributes of the message.
    """
    order = ">" if changes.get("is_bigendian") else "<"
    columns = [("x", layout), ("y", layout), ("z", layout), ("intensity", "u1")]
    kinds = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
    record = np.dtype([(name, order + kind) for name, kind in columns + ([time[:2]] if time else [])])
    records: NDArray[Any] = np.zeros(len(sweep.points), record)
    for k, axis in enumerate("xyz"):
        records[axis] = sweep.points[:, k]
    if time:
        records[time[0]] = sweep.times / time[2]
    fields = [
        SimpleNamespace(name=name, offset=record.fields[name][1], datatype=kinds[record[name].str[1:]], count=1)
        for name in record.names
    ]
    stamp = SimpleNamespace(sec=int(sweep.stamp), nanosec=round(sweep.stamp % 1 * 1e9))
    values = {
        "header": SimpleNamespace(stamp=stamp, frame_id="lidar"),
        "height": 1,
        "width": len(records),
        "fields": fields,
        "is_bigendian": False,
        "point_step": record.itemsize,
        "row_step": record.itemsize * len(records),
        "data": records.tobytes(),
        "is_dense": True,
    }
    return SimpleNamespace(**values | changes)


def bag_of_sweeps(path: Path, sweeps: Iterable[Sweep], topics: Sequence[str] = ("/points",)) -> Path:
    """Write sweeps into a ROS 2 bag, with the time of each point as nanoseconds since the first, as Ouster does."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/PointCloud2"
    with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        connections = [writer.add_connection(topic, kind, typestore=store) for topic in topics]
        for sweep in sweeps:
            flat = message(sweep, time=("t", "u4", 1e-9))
            stamp = store.types["builtin_interfaces/msg/Time"](flat.header.stamp.sec, flat.header.stamp.nanosec)
            field = store.types["sensor_msgs/msg/PointField"]
            cloud = store.types[kind](
                store.types["std_msgs/msg/Header"](stamp, "lidar"),
                1,
                flat.width,
                [field(each.name, each.offset, each.datatype, 1) for each in flat.fields],
                False,
                flat.point_step,
                flat.row_step,
                np.frombuffer(flat.data, np.uint8),
                True,
            )
            for connection in connections:
                writer.write(connection, round(sweep.stamp * 1e9) + 1, store.serialize_cdr(cloud, kind))
    return path


def drive(seconds: float, pattern: Pattern, begin: float = 0.0, corners: Any = ROUND) -> SimulatedSweeps:
    """Return what a lidar sees on a drive through the simulated building."""
    return SimulatedSweeps("building", patrol(corners, seconds, begin=begin), pattern)
