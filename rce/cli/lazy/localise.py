"""Implementation of `rce localise`: the trajectory of a recording in a stored map."""

from __future__ import annotations

import argparse

from rce.cli.lazy.plan import pose
from rce.cli.session import ConsoleSession
from rce.errors import NotFound
from rce.mapping.evaluation.trials.localisation import Localisation, localise
from rce.mapping.files.maps import read_map
from rce.mapping.files.outputs import trajectory_text, write_atomically
from rce.mapping.files.picture import draw
from rce.mapping.files.recordings import open_recording
from rce.mapping.localiser import Localiser


def run(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Localise a recording, and write its trajectory and a picture.

    Raises:
        InvalidRequest: Wrong options, or a file that cannot be read.
        NotFound: A file is missing, or the robot is nowhere in the map.
    """
    grid = read_map(args.map)
    recording = open_recording(args.recording, args.scan_topic, args.odometry_topic)
    found = localise(Localiser(grid, pose(args.start, "--start") if args.start else None), recording)
    if not len(found.trajectory):
        raise NotFound(f"{recording.name}: the robot was found nowhere in {args.map}", field="map")
    args.out.mkdir(parents=True, exist_ok=True)
    write_atomically(args.out / "trajectory.txt", trajectory_text(found.trajectory))
    write_atomically(args.out / "map.png", draw(grid, found.trajectory))
    print(f"{describe(found)}; in {args.out}: trajectory.txt, map.png")


def describe(found: Localisation) -> str:
    """Return what was found as a sentence."""
    first = 1 + (found.first or 0)
    lost = f", lost {found.losses} times" if found.losses else ""
    return f"{len(found.trajectory)} of {found.scans} scans localised, from scan {first} on{lost}"
