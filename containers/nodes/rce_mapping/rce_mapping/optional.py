"""Message types of packages that the ROS 2 wheels lack. They are None, and their features off, if not installed."""

from __future__ import annotations

import importlib
from typing import Any


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


TFMessage: Any = getattr(_module("tf2_msgs.msg"), "TFMessage", None)
OccupancyGridUpdate: Any = getattr(_module("map_msgs.msg"), "OccupancyGridUpdate", None)
nav2 = _module("nav2_msgs.srv")
slam_toolbox = _module("slam_toolbox.srv")
