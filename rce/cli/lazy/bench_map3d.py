"""Implementation of `rce bench map3d`."""

from __future__ import annotations

import argparse
from importlib import import_module
from typing import cast

from rce.cli.lazy.map3d import intrinsics
from rce.cli.output import Columns, print_table
from rce.cli.session import ConsoleSession
from rce.errors import InvalidRequest
from rce.mapping3d.evaluation.offloading import WAYS, Offloading
from rce.mapping3d.evaluation.offloading import measure as offload
from rce.mapping3d.evaluation.trial import Trial, ground_truth, run
from rce.mapping3d.files.recordings import RgbdRecording, camera_of, open_recording

COLUMNS: Columns[Trial] = {
    "recording": lambda trial: trial.recording,
    "frames": lambda trial: str(trial.frames),
    "lost": lambda trial: str(trial.lost),
    "key frames": lambda trial: str(trial.key_frames),
    "ATE m": lambda trial: f"{trial.absolute:.4f}",
    "RPE m/s": lambda trial: f"{trial.drift:.4f}",
    "RPE deg/s": lambda trial: f"{trial.turn:.2f}",
    "front end Hz": lambda trial: f"{trial.front_rate:.0f}",
    "back end Hz": lambda trial: f"{trial.back_rate:.0f}",
    "line kB/s": lambda trial: f"{trial.line_rate / 1000:.0f}",
    "CPU s": lambda trial: f"{trial.seconds:.1f}",
    "MB": lambda trial: f"{trial.megabytes:.0f}",
}

OFFLOADING: Columns[Offloading] = {
    "recording": lambda cost: cost.recording,
    "way": lambda cost: cost.way,
    "line kB/s": lambda cost: f"{cost.line_rate / 1000:.0f}",
    "robot's CPU %": lambda cost: f"{100 * cost.robot_load:.0f}",
    "cloud's CPU %": lambda cost: f"{100 * cost.cloud_load:.0f}",
    "ATE m": lambda cost: f"{cost.absolute:.4f}",
}


def measure(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Map each recording by itself and print its errors and what it took, or the cost of each way to offload.

    Raises:
        InvalidRequest: A recording or its ground truth is damaged.
    """
    camera = intrinsics(args.camera) if args.camera else None
    if args.offloading:
        import_module("av")  # fail now if it is missing, not after a minute
        recordings = [open_recording(path, camera, args.depth_scale) for path in args.recordings]
        truths = [ground_truth(path) for path in args.recordings]
        if any(camera_of(each) is None for each in recordings):
            raise InvalidRequest("--offloading compares ways for cameras with depth: a recording is of a lidar")
        costs = [
            offload(cast("RgbdRecording", each), truth, way)
            for each, truth in zip(recordings, truths, strict=True)
            for way in WAYS
        ]
        print_table(costs, OFFLOADING, args.json)
        return
    trials = [
        run(open_recording(path, camera, args.depth_scale, args.topic), ground_truth(path)) for path in args.recordings
    ]
    print_table(trials, COLUMNS, args.json)
