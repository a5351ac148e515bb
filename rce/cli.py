"""The command `rce`."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable

import rce
from rce import programs, settings
from rce.errors import RceError

PROGRAMS = {
    "master": "run a Master",
    "robot": "run a Robot endpoint",
    "container": "run a Container task set",
    "environment": "run an Environment endpoint (the task set does this)",
    "bridge": "carry topics of a robot that runs ROS 2 to an environment and back",
    "map-service": "run the map service: recordings in, maps out",
    "image": "images with your own ROS packages, on this machine's Docker",
    "user": "users and API keys of a Master on this machine",
    "machine": "machines that may join a Master on this machine",
}


def up(arguments: list[str]) -> int:
    from rce import up as platform

    asyncio.run(platform.serve(settings.load_or_exit(platform.Settings, "rce up", arguments)))
    return 0


def map_recordings(arguments: list[str]) -> int:
    from rce.commands import map_jobs

    if arguments and arguments[0] in map_jobs.NAMES:
        return map_jobs.main(arguments)
    from rce.commands import map as command

    return command.main(arguments)


def run_robot(arguments: list[str]) -> int:
    from rce.commands import run as command

    return command.main(arguments)


def package(arguments: list[str]) -> int:
    from rce.commands import package as command

    return command.main(arguments)


def bench(arguments: list[str]) -> int:
    from rce.commands import bench as command

    return command.main(arguments)


COMMANDS: dict[str, tuple[str, Callable[[list[str]], int]]] = {
    "up": ("run the whole platform on this machine", up),
    "map": ("make a map of recorded laser scans", map_recordings),
    "run": ("be a robot that a file describes", run_robot),
    "package": ("your own ROS packages at a platform", package),
    "bench": ("measure a platform", bench),
}


def usage() -> str:
    lines = ["usage: rce COMMAND …; rce COMMAND --help tells more", ""]
    for name, text in {**{name: text for name, (text, _) in COMMANDS.items()}, **PROGRAMS}.items():
        lines.append(f"  {name:12} {text}")
    return "\n".join(lines)


def main() -> int:
    """Status 0: done; 1: it failed, and the reason is on standard error; 2: the command line is wrong."""
    match sys.argv[1:]:
        case [] | ["-h" | "--help" | "help"]:
            print(usage())
            return 0
        case ["--version"]:
            print(f"rce {rce.__version__}")
            return 0
        case [name, *arguments] if name in COMMANDS:
            return _run(COMMANDS[name][1], arguments)
        case [name, *arguments] if name in PROGRAMS:
            return _run(lambda words: programs.become(name, words), arguments)
        case [name, *_]:
            print(f"rce: there is no command {name!r}\n\n{usage()}", file=sys.stderr)
            return 2
    raise AssertionError("every list of words is one of these")


def _run(command: Callable[[list[str]], int], arguments: list[str]) -> int:
    try:
        return command(arguments)
    except RceError as error:
        print(f"rce: {error}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:  # a light installation; a module of ours that is missing is a defect
        if error.name is None or error.name.partition(".")[0] == "rce":
            raise
        print(f"rce: this needs {error.name}: pip install 'rce[server,mapping,ros,bench]'", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
