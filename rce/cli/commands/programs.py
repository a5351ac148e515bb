"""`up`, `run`, and the programs of the platform, which parse their own command lines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rce.cli.arguments import argument
from rce.cli.command import Command, Lazy, Program, Section


def up(arguments: list[str]) -> int:
    """Run the whole platform on this machine until a signal ends it."""
    import asyncio

    from rce.process import settings
    from rce.process import up as platform

    asyncio.run(platform.serve(settings.load_or_exit(platform.Settings, "rce up", arguments)))
    return 0


def _installed(name: str) -> Callable[[list[str]], int]:
    """Return a function that replaces this process by the installed program of this name."""

    def run(arguments: list[str]) -> int:
        from rce.process import programs

        programs.exec_program(name, arguments)

    return run


def _has_options_only(arguments: Sequence[str]) -> bool:
    return not arguments or arguments[0].startswith("-")


def _has_option(*flags: str) -> Callable[[Sequence[str]], bool]:
    return lambda arguments: any(argument.partition("=")[0] in flags for argument in arguments)


UP = Program("up", "Run the whole platform on this machine.", up, Section.LOCAL)
RUN = Command(
    "run",
    "Run a robot that a file describes.",
    Lazy("rce.cli.lazy.run", "run"),
    (argument("file", type=Path, metavar="FILE", help="robot file: JSON as the original's rce-ros reads it, or YAML"),),
    ("run robot.json",),
    platform=None,
    section=Section.LOCAL,
    description="Connects as the robot, creates its environments, nodes, interfaces and connections, and removes them "
    'at the end (Ctrl-C). Prints each message to the robot as a line {"iTag": ..., "msg": ...} and sends lines of this '
    "form from standard input.",
)
BRIDGE = Program(
    "bridge",
    "Carry topics of a robot that runs ROS 2 to an environment and back.",
    _installed("bridge"),
    Section.LOCAL,
)
IMAGE = Program(
    "image",
    "Build images with your own ROS packages, with this machine's Docker.",
    _installed("image"),
    Section.LOCAL,
)
SERVERS = (
    Program("master", "Run a Master.", _installed("master"), Section.SERVER),
    Program(
        "robot",
        "Run a Robot endpoint (`rce robot list` and so on are commands, see above).",
        _installed("robot"),
        Section.SERVER,
        _has_options_only,
    ),
    Program(
        "container",
        "Run a Container task set: the environments of a machine.",
        _installed("container"),
        Section.SERVER,
        _has_options_only,
    ),
    Program(
        "environment",
        "Run an Environment endpoint (the task set starts these).",
        _installed("environment"),
        Section.SERVER,
    ),
    Program("map-service", "Run the map service: recordings in, maps out.", _installed("map-service"), Section.SERVER),
    Program(
        "knowledge-service",
        "Run the knowledge service: recipes, objects and environments that robots share.",
        _installed("knowledge-service"),
        Section.SERVER,
    ),
)
ON_MASTER_FILES = (
    Program(
        "user",
        "users and API keys",
        _installed("user"),
        Section.MASTER_FILES,
        _has_option("--data-dir", "--database"),
        "user --data-dir …",
    ),
    Program(
        "machine",
        "machines that may join",
        _installed("machine"),
        Section.MASTER_FILES,
        _has_option("--config"),
        "machine --config …",
    ),
    Program("backup", "save database, packages and settings", _installed("backup"), Section.MASTER_FILES),
    Program("restore", "restore a backup; the Master must not run", _installed("restore"), Section.MASTER_FILES),
)
COMPLETE = Program(
    "complete",
    "Print completions of the words so far; the scripts of `rce completion` call it.",
    Lazy("rce.cli.completion", "complete"),
    Section.HIDDEN,
)
