"""Start and end of the nodes."""

from __future__ import annotations

import importlib

import rclpy
from rclpy.executors import ExternalShutdownException


def main(module: str, name: str) -> int:
    """Run a node, a class of a module of this package, until SIGINT or SIGTERM; both are a normal end."""
    rclpy.init()
    try:
        # Imports and compiles the kernels, which may take seconds: by now a signal ends the node as it should.
        make = getattr(importlib.import_module(f".{module}", __package__), name)
        rclpy.spin(make())
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except Exception:  # what fails because of the shutdown is no failure
        if rclpy.ok():
            raise
    finally:
        rclpy.try_shutdown()
    return 0
