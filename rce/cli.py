"""The command `rce`: programs of the platform, work on this machine, and the console's commands one at a time.

One word may be of two of these. `robot` and `container` are programs, which take options only, unless another word
follows. `user` and `machine` go to the platform (by a context or --url, as all of the console's); with an option that
names a Master's files they work on those, whether that Master runs or not.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence

import rce
from rce.errors import RceError

PROGRAMS = {
    "master": "run a Master",
    "robot": "run a Robot endpoint",
    "container": "run a Container task set",
    "environment": "run an Environment endpoint (the task set does this)",
    "bridge": "carry topics of a robot that runs ROS 2 to an environment and back",
    "map-service": "run the map service: recordings in, maps out",
    "image": "images with your own ROS packages, on this machine's Docker",
}
ON_FILES = {
    "user": (("--data-dir", "--database"), "users and API keys in the database of a Master on this machine"),
    "machine": (("--config",), "machines that may join a Master on this machine"),
}
"""Programs that work on a Master's files, by the options that say so."""


def up(arguments: list[str]) -> int:
    import asyncio

    from rce import settings
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
    from rce.console import table

    lines = ["usage: rce COMMAND …; rce COMMAND --help tells more", ""]
    lines += [f"  {name:12} {text}" for name, (text, _) in COMMANDS.items()]
    lines += [f"  {name:12} {text}" for name, text in PROGRAMS.items()]
    for name, (options, text) in ON_FILES.items():
        lines.append(f"  {name:12} with {' or '.join(options)}: {text}")
    return "\n".join([*lines, "", "at a platform, also in `rce console`:", table.overview()])


def main() -> int:
    """Status 0: done; 1: it failed, and the reason is on standard error; 2: the command line is wrong."""
    match sys.argv[1:]:
        case [] | ["-h" | "--help"] | ["help"]:
            print(usage())
            return 0
        case ["--version"]:
            print(f"rce {rce.__version__}")
            return 0
        case [name, *arguments] if name in COMMANDS:
            return _run(COMMANDS[name][1], arguments)
        case [name, *arguments] if is_program(name, arguments):
            return _run(lambda words: _become(name, words), arguments)
        case words:
            return _run(_console, words)


def is_program(name: str, arguments: Sequence[str]) -> bool:
    """Whether these words start a program of the platform."""
    if name in ON_FILES:
        return any(word.partition("=")[0] in ON_FILES[name][0] for word in arguments)
    if name in ("robot", "container"):
        return not arguments or arguments[0].startswith("-")
    return name in PROGRAMS


def _become(name: str, arguments: list[str]) -> int:
    from rce import programs

    programs.become(name, arguments)


def _console(words: list[str]) -> int:
    from rce.console import run, table
    from rce.console.original import modern

    if words[0] == "complete":
        from rce.console.completing import complete

        return complete(words[1:])
    if words[0] not in table.WORDS and modern(words) == words:
        print(f"rce: there is no command {words[0]!r}\n\n{usage()}", file=sys.stderr)
        return run.WRONG
    return run.run(words)


def _run(command: Callable[[list[str]], int], arguments: list[str]) -> int:
    try:
        return command(arguments)
    except RceError as error:
        print(f"rce: {error}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:  # a light installation; a module of ours that is missing is a defect
        if error.name is None or error.name.partition(".")[0] == "rce":
            raise
        extras = "console" if error.name.partition(".")[0] in ("rich", "prompt_toolkit") else "server,mapping,ros,bench"
        print(f"rce: this needs {error.name}: pip install 'rce[{extras}]'", file=sys.stderr)
        return 1
    except BrokenPipeError:  # who read this has seen enough: `rce map status | head`
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115  # so that the interpreter's last flush goes well
        return 1
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
