"""Implementation of `rce map3d`: recordings are tracked here and mapped by a node in an environment."""

from __future__ import annotations

import argparse
import asyncio
import math
import os
import sys
import time
from pathlib import Path

from rce.cli.platform import platform
from rce.cli.session import ConsoleSession
from rce.errors import InvalidRequest
from rce.mapping3d.files.recordings import Intrinsics, Recording3d, open_recording
from rce.mapping3d.offload.runs import map_recordings

TERMINAL_INTERVAL, LINE_INTERVAL = 0.2, 5.0  # seconds between reports of progress on a terminal, and elsewhere


def run(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Map the recordings and write the files of the map.

    Raises:
        InvalidRequest: Wrong options, or a file that cannot be read or written.
    """
    camera = intrinsics(args.camera) if args.camera else None
    if args.depth_scale is not None and not 0 < args.depth_scale < math.inf:
        raise InvalidRequest("--depth-scale must be a positive number: the units of depth images in a metre")
    check_writable(args.out)
    recordings = [open_recording(path, camera, args.depth_scale, args.topic) for path in args.recordings]
    asyncio.run(_map(args, recordings))


async def _map(args: argparse.Namespace, recordings: list[Recording3d]) -> None:
    progress = Progress(sum(each.frames for each in recordings))
    async with platform(args) as access:
        maps, figures = await map_recordings(access, recordings, args.out, progress.update)
    progress.end()
    print(
        f"{figures.frames} frames, {figures.lost} without track, {figures.key_frames} key frames of "
        f"{figures.sent / 1e6:.1f} MB sent, {1000 * figures.seconds / figures.frames:.1f} ms of CPU time a frame here"
    )
    for path, robots in maps:
        names = ", ".join(recordings[robot].name for robot in robots)
        print(f"map of {names} in {path}: {', '.join(sorted(each.name for each in path.iterdir() if each.is_file()))}")
    if len(maps) > 1:
        print(f"{len(maps)} maps: no overlap was found between robots on different maps")


def intrinsics(text: str) -> Intrinsics:
    """Return fx, fy, cx, cy.

    Raises:
        InvalidRequest: The text is not four numbers, or a focal length is not positive.
    """
    try:
        fx, fy, cx, cy = (float(word) for word in text.split(","))
    except ValueError:
        raise InvalidRequest(f"--camera: {text!r} is not FX,FY,CX,CY: four numbers in pixels") from None
    if not all(map(math.isfinite, (fx, fy, cx, cy))) or fx <= 0 or fy <= 0:
        raise InvalidRequest("--camera: the focal lengths FX and FY must be positive")
    return fx, fy, cx, cy


def check_writable(directory: Path) -> None:
    """Check that a directory can be made or written to, before hours of work.

    Raises:
        InvalidRequest: It cannot.
    """
    existing = next(path for path in (directory, *directory.absolute().parents) if path.exists())
    if not existing.is_dir() or not os.access(existing, os.W_OK):
        fault = "is not writable" if existing.is_dir() else "is not a directory"
        raise InvalidRequest(f"{existing} {fault}: choose another directory with --out")


class Progress:
    """Progress on standard error: one line that changes on a terminal, a line every few seconds elsewhere."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._count = 0
        self._began = self._printed = time.monotonic()
        self._terminal = sys.stderr.isatty()

    def update(self, count: int) -> None:
        """Record the number of frames so far, and print it from time to time."""
        self._count = count
        now = time.monotonic()
        if now - self._printed >= (TERMINAL_INTERVAL if self._terminal else LINE_INTERVAL):
            self._printed = now
            self._print("" if self._terminal else "\n")

    def end(self) -> None:
        """Print the final state."""
        self._print("\n")

    def _print(self, end: str) -> None:
        elapsed = time.monotonic() - self._began
        text = f"{self._count}/{self._total} frames, {self._count / max(elapsed, 1e-9):.1f} a second, {elapsed:.0f} s"
        start = "\r" if self._terminal else ""
        print(start + text, end=end, file=sys.stderr, flush=True)
