"""Several recordings, as if all robots had begun at the same time."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence

import numpy as np

from rce.mapping3d.files.recordings import RgbdRecording
from rce.mapping3d.frames import RgbdFrame, reduced


def together(recordings: Sequence[RgbdRecording]) -> Iterator[tuple[int, RgbdFrame]]:
    """Yield the frames of all robots as if all had begun at the same time."""

    def frames(robot: int) -> Iterator[tuple[float, int, RgbdFrame]]:
        begin: float | None = None
        last = -np.inf
        for frame in recordings[robot]:
            begin = frame.stamp if begin is None else begin
            if frame.stamp > last:
                last = frame.stamp
                yield frame.stamp - begin, robot, reduced(frame)

    for _, robot, frame in heapq.merge(
        *(frames(robot) for robot, _ in enumerate(recordings)), key=lambda each: each[:2]
    ):
        yield robot, frame
