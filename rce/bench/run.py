"""Sampling: one sample of each probe in turn, so that other load of the machine affects all alike."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Sequence

from rce.bench.nodes import Probe
from rce.bench.payloads import IMAGE
from rce.bench.statistics import Series

PAUSE = 0.005, 0.014  # seconds between samples; without a pause a server that polls would look better than it is


async def take(
    probes: Sequence[Probe], sizes: Sequence[int], samples: int, progress: Callable[[int, int], None]
) -> list[Series]:
    """Measure `samples` round trips of each probe and size, after one that is discarded.

    Args:
        probes: The probes.
        sizes: Sizes in bytes.
        samples: Number of samples.
        progress: Called with the number of sizes done and of all sizes.
    """
    series = [Series(probe.name, probe.transport, probe.beside) for probe in probes]
    images = [IMAGE] if any(probe.size == IMAGE for probe in probes) else []
    all_sizes = [*sizes, *images]
    for done, size in enumerate(all_sizes):
        fit = [pair for pair in zip(probes, series, strict=True) if fits(pair[0], size, done >= len(sizes))]
        for number in range(samples + 1):
            for probe, into in fit:
                seconds = await probe.sample(size)
                if number:
                    into.add(size, seconds)
                await asyncio.sleep(random.uniform(*PAUSE))
        progress(done + 1, len(all_sizes))
    return series


def fits(probe: Probe, size: int, image: bool) -> bool:
    """Return whether a probe is measured with this size; bare echoes are measured with the size of images, too."""
    if image:
        return probe.size == size or probe.transport == "floor"
    return probe.size is None
