"""Trajectories in the format of the TUM RGB-D benchmark: lines `timestamp tx ty tz qx qy qz qw`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from rce.errors import InvalidRequest, NotFound
from rce.mapping3d.poses import Pose, from_quaternion, to_quaternion

Stamped = tuple[float, Pose]


def trajectory_text(trajectory: Iterable[Stamped]) -> bytes:
    """Return the lines of a trajectory: seconds, metres, unit quaternions."""
    lines = []
    for stamp, pose in trajectory:
        values = " ".join(f"{value:.6f}" for value in (*pose[:3, 3], *to_quaternion(pose)))
        lines.append(f"{stamp:.6f} {values}\n")
    return "".join(lines).encode()


def read_trajectory(path: Path) -> list[Stamped]:
    """Return the poses of a trajectory in order of time. Lines that begin with # are comments.

    Raises:
        NotFound: The file does not exist.
        InvalidRequest: A line is not in the format.
    """
    if not path.is_file():
        raise NotFound(f"no such trajectory: {path}", field="path")
    poses = []
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        text = line.split("#", 1)[0].replace(",", " ").split()
        if not text:
            continue
        try:
            stamp, *rest = (float(word) for word in text)
            if len(rest) != 7 or not all(map(math.isfinite, (stamp, *rest))) or not any(rest[3:]):
                raise ValueError("8 numbers expected: timestamp tx ty tz qx qy qz qw")
        except ValueError as error:
            raise InvalidRequest(f"{path.name}, line {number}: {error}", field="path") from None
        poses.append((stamp, from_quaternion(rest[:3], rest[3:])))
    if not poses:
        raise InvalidRequest(f"{path.name} has no poses", field="path")
    return sorted(poses, key=lambda each: each[0])


def nearest_stamps(first: Sequence[float], second: Sequence[float], bound: float = 0.02) -> list[tuple[int, int]]:
    """Return pairs of places of stamps that are at most `bound` seconds apart, each used once, nearest pairs first.

    This is how the TUM benchmark associates colours, depths and ground truth. Both sequences are in order.
    """
    candidates = []
    begin = 0
    for i, stamp in enumerate(first):
        while begin < len(second) and second[begin] < stamp - bound:
            begin += 1
        k = begin
        while k < len(second) and second[k] <= stamp + bound:
            candidates.append((abs(second[k] - stamp), i, k))
            k += 1
    used_first: set[int] = set()
    used_second: set[int] = set()
    pairs = []
    for _, i, k in sorted(candidates):
        if i not in used_first and k not in used_second:
            used_first.add(i)
            used_second.add(k)
            pairs.append((i, k))
    return sorted(pairs)
