"""Start and end of the node."""

from __future__ import annotations

import rclpy
from rclpy.executors import ExternalShutdownException


def main() -> int:
    """Run the node until SIGINT or SIGTERM; both are a normal end."""
    rclpy.init()
    try:
        # Imports and compiles the kernels, which may take seconds: by now a signal ends the node as it should.
        from .node import MapperNode

        rclpy.spin(MapperNode())
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except Exception:  # what fails because of the shutdown is no failure
        if rclpy.ok():
            raise
    finally:
        rclpy.try_shutdown()
    return 0
