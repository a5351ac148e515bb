"""Garbage collection of processes with millions of objects that are all in use."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable

# Python's are 700, 10, 10. A collection of 50,000 young objects takes 40 to 140 ms, so there are fewer in each. The
# third puts off the full collections that Python begins by itself.
THRESHOLDS = (5_000, 10, 1_000_000)
SHORTEST = 60.0  # seconds between full collections
SHARE = 1e-4  # of the time, at most, for full collections


def collect_seldom(later: Callable[[float, Callable[[], object]], object]) -> None:
    """Run full collections for a ten-thousandth of the time, and young ones of 5,000 objects each.

    A full collection stops the event loop: for some 30 ms in a Master that has just started, and for more than a second
    where it keeps records of 10,000 robots. So one of 30 ms comes every five minutes, one of a second every 3 h.

    Args:
        later: Calls a function after so many seconds, such as `call_later` of the event loop.
    """
    gc.set_threshold(*THRESHOLDS)

    def collect() -> None:
        began = time.perf_counter()
        gc.collect()
        later(max(SHORTEST, (time.perf_counter() - began) / SHARE), collect)

    later(SHORTEST, collect)
