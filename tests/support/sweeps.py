"""Sweeps of a lidar as messages."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.lidar.clouds import Sweep


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
