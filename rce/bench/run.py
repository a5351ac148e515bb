"""Taking the samples: one of each probe in turn, so that what else the machine does hits all alike."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Sequence

from rce.bench.nodes import Probe
from rce.bench.payloads import IMAGE
from rce.bench.statistics import Series

PAUSE = 0.005, 0.014  # seconds between samples: without them a server that polls looks better than it is


async def take(
    probes: Sequence[Probe], sizes: Sequence[int], samples: int, progress: Callable[[int, int], None]
) -> list[Series]:
    """`samples` round trips of each probe and size, after one that does not count."""
    series = [Series(probe.name, probe.transport, probe.beside) for probe in probes]
    images = [IMAGE] if any(probe.size == IMAGE for probe in probes) else []
    every = [*sizes, *images]
    for done, size in enumerate(every):
        fit = [pair for pair in zip(probes, series, strict=True) if fits(pair[0], size, done >= len(sizes))]
        for number in range(samples + 1):
            for probe, into in fit:
                seconds = await probe.sample(size)
                if number:
                    into.add(size, seconds)
                await asyncio.sleep(random.uniform(*PAUSE))
        progress(done + 1, len(every))
    return series


def fits(probe: Probe, size: int, image: bool) -> bool:
    """Whether the probe takes this size; bare echoes are also taken at the size of images."""
    if image:
        return probe.size == size or probe.transport == "floor"
    return probe.size is None
