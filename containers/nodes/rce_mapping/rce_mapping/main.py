"""Main function of the nodes."""

from __future__ import annotations

import importlib

import rclpy
from rclpy.executors import ExternalShutdownException


def main(module: str, name: str) -> int:
    """Run a node until SIGINT or SIGTERM, which are a normal end; return the exit status.

    Args:
        module: Its module.
        name: Class of the node in that module.
    """
    rclpy.init()
    try:
        # The import may compile the kernels, which takes seconds. It comes after rclpy.init, so that a signal ends the
        # node normally meanwhile.
        make = getattr(importlib.import_module(module), name)
        rclpy.spin(make())
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except Exception:  # a consequence of the shutdown if rclpy is shut down already
        if rclpy.ok():
            raise
    finally:
        rclpy.try_shutdown()
    return 0
