"""Trial of the mapper on a recording with ground truth."""

from __future__ import annotations

import math
import resource
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rce.errors import InvalidRequest
from rce.mapping3d.evaluation.errors import trajectory_error
from rce.mapping3d.files.recordings import Recording3d
from rce.mapping3d.files.recordings.seven_scenes import RATE
from rce.mapping3d.files.trajectories import Stamped, read_trajectory
from rce.mapping3d.pipeline import Mapping


@dataclass(frozen=True, slots=True)
class Trial:
    """Result of a trial.

    Attributes:
        recording: Name of the recording.
        frames: Number of frames.
        lost: Those without track.
        key_frames: Number of key frames.
        absolute: Absolute trajectory error, metres, root mean square; NaN without ground truth.
        drift: Relative pose error over one second, metres, root mean square.
        turn: The same of the rotation, degrees.
        front_rate: Frames a second of CPU time of the front end.
        back_rate: Frames a second of CPU time of the back end.
        line_rate: Bytes a second of packed key frames in the time of the recording.
        seconds: Of CPU time, with the reading of the recording.
        megabytes: Peak memory of the process so far.
    """

    recording: str
    frames: int
    lost: int
    key_frames: int
    absolute: float
    drift: float
    turn: float
    front_rate: float
    back_rate: float
    line_rate: float
    seconds: float
    megabytes: float


def run(recording: Recording3d, truth: list[Stamped]) -> Trial:
    """Map a recording and compare the trajectory with ground truth, of which there may be none.

    Raises:
        InvalidRequest: The recording is damaged, or its stamps are not those of the ground truth.
    """
    began = time.process_time()
    mapping = Mapping([recording])
    mapping.run()
    seconds = time.process_time() - began
    path = mapping.trajectory(0)
    error = trajectory_error(path, truth) if truth else None
    figures, store = mapping.figures, mapping.mapper.store
    duration = max(path[-1][0] - path[0][0], 1e-9)
    packed = [store.packed(number) for number in range(len(store))]
    result = Trial(
        recording.name,
        figures.frames,
        figures.lost,
        len(store),
        error.absolute if error else math.nan,
        error.drift if error else math.nan,
        math.degrees(error.turn) if error else math.nan,
        figures.frames / max(figures.front, 1e-9),
        figures.frames / max(figures.back, 1e-9),
        sum(len(each.color) + len(each.depth) + len(each.cloud) for each in packed) / duration,
        seconds,
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    )
    mapping.mapper.close()
    return result


def ground_truth(path: Path) -> list[Stamped]:
    """Return the ground truth in the directory of a recording; none for bags and where there is no file.

    It is groundtruth.txt in the format of TUM, or frame-NNNNNN.pose.txt for each frame as in 7-Scenes.

    Raises:
        InvalidRequest: A file is damaged.
    """
    if not path.is_dir():
        return []
    if (path / "groundtruth.txt").is_file():
        return read_trajectory(path / "groundtruth.txt")
    poses = []
    for file in sorted(path.glob("frame-*.pose.txt")):
        try:
            pose = np.loadtxt(file).reshape(4, 4)
            number = int(file.name.split("-")[1].split(".")[0])
        except ValueError as error:
            raise InvalidRequest(f"{file.name} is not a pose: a number and a 4 x 4 matrix ({error})") from None
        if np.isfinite(pose).all():
            poses.append((number / RATE, pose))
    return poses
