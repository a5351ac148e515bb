"""Waiting for a condition while an rclpy executor runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

LIMIT = 60.0  # seconds until a test gives up


def spin_until(executor: Any, condition: Callable[[], bool]) -> None:
    """Run an executor until a condition holds. AssertionError after LIMIT.

    The bound is a time and not a number of callbacks: nodes have timers, and a busy executor runs thousands of
    callbacks before the next one is due.
    """
    deadline = time.monotonic() + LIMIT
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f"the condition does not hold after {LIMIT:g} s")
        executor.spin_once(timeout_sec=0.05)
