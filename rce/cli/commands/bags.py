"""`bag record`, `bag play` and `bag info`: recordings of topics as MCAP files."""

from __future__ import annotations

from pathlib import Path

from rce.cli.arguments import ENVIRONMENT, JSON, OF_USER, argument
from rce.cli.command import Command, Group, Lazy, Section
from rce.cli.commands.data import AsGuest

MODULE = "rce.cli.lazy.bag"

GROUP = Group(
    "bag",
    "Record and play topics; list, download and upload the platform's recordings.",
    "Recordings are MCAP files with the definitions of their types, as rosbag2, Foxglove and Lichtblick read them.",
)

COMMANDS = (
    Command(
        "bag record",
        "Record topics of an environment into a file, until Ctrl-C.",
        AsGuest(Lazy(MODULE, "record"), address=""),
        (
            ENVIRONMENT,
            argument("topics", nargs="*", metavar="TOPIC", help="(default: all, also those that appear later)"),
            argument("-o", "--out", type=Path, required=True, metavar="FILE.mcap", help="file, which must not exist"),
            argument("--max-size", type=float, default=0, metavar="MB", help="begin another file after so many MB"),
            argument("--max-duration", type=float, default=0, metavar="S", help="begin another file after S seconds"),
            argument("--duration", type=float, default=0, metavar="S", help="end after S seconds"),
            OF_USER,
        ),
        ("bag record brain --out drive.mcap", "bag record brain /scan /odom -o drive.mcap --max-size 1000"),
    ),
    Command(
        "bag play",
        "Publish the messages of a recording in an environment, at the intervals at which they arrived.",
        AsGuest(Lazy(MODULE, "play"), address=""),
        (
            argument("file", type=Path, metavar="FILE.mcap"),
            ENVIRONMENT,
            argument("-r", "--rate", type=float, default=1.0, metavar="R", help="speed (default: %(default)s)"),
            argument("-l", "--loop", action="store_true", help="again and again, until Ctrl-C"),
            argument("--clock", action="store_true", help="publish the recording's time on /clock"),
            argument(
                "--stay", action="store_true", help="wait at the end for viewers that play it again, until Ctrl-C"
            ),
            OF_USER,
        ),
        ("bag play drive.mcap brain", "bag play drive.mcap brain --rate 0.5 --clock --loop"),
    ),
    Command(
        "bag info",
        "Print topics, types and numbers of messages of recordings; also of one that was cut off.",
        Lazy(MODULE, "info"),
        (argument("files", nargs="+", type=Path, metavar="FILE.mcap"), JSON),
        ("bag info drive.mcap",),
        platform=None,
        section=Section.LOCAL,
    ),
)
