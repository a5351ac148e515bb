"""Garbage collection of processes with millions of objects that are all in use."""

from __future__ import annotations

import gc

# In place of 700, 10, 10. A full collection stops the event loop for a second and more, and finds nothing in records
# and connections that are in use. A collection of 50,000 young objects takes 40 to 140 ms, so there are fewer in each.
THRESHOLDS = (5_000, 10, 2_000)


def collect_seldom() -> None:
    """Run full collections a thousand times as seldom as Python does, and young ones of 5,000 objects each."""
    gc.set_threshold(*THRESHOLDS)
