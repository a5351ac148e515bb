"""`package`: a user's own ROS packages at a platform."""

from __future__ import annotations

from pathlib import Path

from rce.cli.arguments import RUNNING, argument
from rce.cli.command import Command, Group, Lazy, Section

NAME = argument("name", metavar="NAME")

GROUP = Group(
    "package",
    "Push, list, share and remove your own ROS packages at a platform.",
    "Environments get packages by name: `packages` of containerData, or robot.create_environment(..., packages=[...]).",
)

COMMANDS = (
    Command(
        "package push",
        "Push packages that need no build: Python sources, or an install space.",
        Lazy("rce.cli.lazy.package", "push"),
        (
            argument("directory", type=Path, metavar="DIR"),
            argument("--name", default="", help="name at the platform (default: that of the package or DIR)"),
            argument("--share", action="append", default=[], metavar="USER|all", help="let others use it, too"),
            argument("--as-is", action="store_true", help="push it even if it looks as if it had to be built first"),
            argument("--text-only", action="store_true", help="without type support: the environment's image has it"),
        ),
        ("package push ~/ros2_ws/install --name fleet", "package push my_package --share ada"),
        platform=RUNNING,
        section=Section.LOCAL,
        description="Pushes DIR as the newest version of a package: a ROS package in Python, a directory of several, "
        "or an install space of colcon (merged or isolated). Type support of messages and services is built on this "
        "machine. Packages that must be built are refused: `rce image build` makes an image with them.",
    ),
    Command(
        "package list",
        "List the packages that you may use.",
        Lazy("rce.cli.lazy.package", "list_packages"),
        (argument("--json", action="store_true", help="print packages as JSON"),),
        platform=RUNNING,
        section=Section.LOCAL,
    ),
    Command(
        "package share",
        "Let others use a package.",
        Lazy("rce.cli.lazy.package", "share"),
        (NAME, argument("users", nargs="+", metavar="USER|all")),
        ("package share fleet ada", "package share fleet all"),
        platform=RUNNING,
        section=Section.LOCAL,
    ),
    Command(
        "package unshare",
        "Stop sharing a package, with these users or with all.",
        Lazy("rce.cli.lazy.package", "unshare"),
        (NAME, argument("users", nargs="*", metavar="USER|all")),
        platform=RUNNING,
        section=Section.LOCAL,
    ),
    Command(
        "package remove",
        "Remove a package or one version of it; environments that use it go on.",
        Lazy("rce.cli.lazy.package", "remove"),
        (argument("name", metavar="NAME[@VERSION]"),),
        platform=RUNNING,
        section=Section.LOCAL,
    ),
)
