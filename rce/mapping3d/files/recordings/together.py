"""Several recordings, as if all robots had begun at the same time."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence

import numpy as np

from rce.mapping.clouds import Sweep
from rce.mapping3d.files.recordings import Recording3d
from rce.mapping3d.frames import RgbdFrame, reduced


def together(recordings: Sequence[Recording3d]) -> Iterator[tuple[int, RgbdFrame | Sweep]]:
    """Yield the frames of all robots as if all had begun at the same time."""

    def frames(robot: int) -> Iterator[tuple[float, int, RgbdFrame | Sweep]]:
        begin: float | None = None
        last = -np.inf
        for frame in recordings[robot]:
            begin = frame.stamp if begin is None else begin
            if frame.stamp > last:
                last = frame.stamp
                small = reduced(frame) if isinstance(frame, RgbdFrame) else frame
                yield frame.stamp - begin, robot, small

    for _, robot, frame in heapq.merge(
        *(frames(robot) for robot, _ in enumerate(recordings)), key=lambda each: each[:2]
    ):
        yield robot, frame
