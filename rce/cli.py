"""The command `rce`: programs of the platform, work on this machine, and the console's commands one at a time.

One word may be of two of these. `robot` and `container` are programs, which take options only, unless another word
follows. `user` and `machine` go to the platform (by a context or --url, as all of the console's); with an option that
names a Master's files they work on those, whether that Master runs or not.
"""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence

import rce

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
STOPPED, UNREAD = 128 + signal.SIGINT, 128 + signal.SIGPIPE  # as a shell says it of programs that a signal ended
PROGRAMS = {
    "master": "Run a Master.",
    "robot": "Run a Robot endpoint (`rce robot list` and so on are commands, see above).",
    "container": "Run a Container task set: the environments of a machine.",
    "environment": "Run an Environment endpoint (the task set does this).",
    "map-service": "Run the map service: recordings in, maps out.",
}
TOOLS = {
    "bridge": "Carry topics of a robot that runs ROS 2 to an environment and back.",
    "image": "Build images with your own ROS packages, with this machine's Docker.",
}
ON_FILES = {
    "user": (("--data-dir", "--database"), "users and API keys"),
    "machine": (("--config",), "machines that may join"),
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
    "up": ("Run the whole platform on this machine.", up),
    "map": ("Make a map of recorded laser scans.", map_recordings),
    "run": ("Be a robot that a file describes.", run_robot),
    "package": ("Push, list, share and remove your own ROS packages at a platform.", package),
    "bench": ("Measure a platform.", bench),
}


def usage() -> str:
    from rce.console import table

    def listed(of: Mapping[str, str]) -> list[str]:
        return [f"  {name:12} {text}" for name, text in of.items()]

    return "\n".join(
        [
            "usage: rce COMMAND …; rce COMMAND --help tells more",
            *("", "to begin: `rce up --dev` runs a platform here; docs/console.md and README.md tell the rest", ""),
            *listed({name: text for name, (text, _) in COMMANDS.items()} | TOOLS),
            *("", "at a platform (`rce login URL` says which), also in `rce console`:"),
            table.overview(),
            *("", "the parts of a platform, one by one:", *listed(PROGRAMS)),
            *("", "on the files of a Master of this machine, whether it runs or not:"),
            *(f"  {name} {options[0]} …  {text}" for name, (options, text) in ON_FILES.items()),
        ]
    )


def main() -> int:
    """Status 0: done; 1: it failed, and the reason is on standard error; 2: the command line is wrong; 130: Ctrl-C;
    141: who read the output has gone (`rce audit | head`)."""
    _take_any_terminal()
    try:
        try:
            return _dispatch(sys.argv[1:])
        finally:
            sys.stdout.flush()  # not left to the interpreter, which would say it in its own way
    except KeyboardInterrupt:
        return STOPPED
    except BrokenPipeError:
        _write_nothing_more()
        return UNREAD
    except OSError as error:
        if error.filename is None and error.errno not in NO_ROOM:
            raise
        from rce.errors import reason

        print(f"rce: {reason(error)}", file=sys.stderr)
        _write_nothing_more()
        return 1


def _take_any_terminal() -> None:
    """What the encoding of a terminal lacks is shown as `?`; a closed standard output is no defect."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115  # for as long as the process lives


def _write_nothing_more() -> None:
    """Else the interpreter tries once more at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _dispatch(words: list[str]) -> int:
    match words:
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
    return name in PROGRAMS or name in TOOLS


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
    from rce.errors import RceError  # here, so that a Ctrl-C while it is imported is met by `main`

    try:
        return command(arguments)
    except RceError as error:
        print(f"rce: {error}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:  # a light installation; a module of ours that is missing is a defect
        if error.name is None or error.name.partition(".")[0] == "rce":
            raise
        extras = "console" if error.name.partition(".")[0] in ("rich", "prompt_toolkit") else "server,mapping,ros,bench"
        print(f"rce: this needs {error.name}: pip install '.[{extras}]' in a checkout of RCE", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
