"""Garbage collection of processes with millions of objects that are all in use."""

from __future__ import annotations

import gc

# In place of 700, 10, 10. A full collection stops a loop for a second and more, and finds nothing in records and
# connections that are in use. A young one of 50,000 objects takes 40 to 140 ms, one of these a few.
THRESHOLDS = (5_000, 10, 2_000)


def collect_seldom() -> None:
    """Collect young garbage as before, and all of it a hundred times as seldom."""
    gc.set_threshold(*THRESHOLDS)
