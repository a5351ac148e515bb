"""Processes of environments and nodes, found in /proc by the directory of their platform (engine `process`)."""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

ENDPOINT = b"endpoints.environment"
_node = re.compile(rb"/environments/[^/]+/([^/]+)/[^/]+/nodes/([^/]+)/parameters\.yaml")
TICKS = os.sysconf("SC_CLK_TCK")


class Process(NamedTuple):
    """A process of an environment; `node` is empty for the endpoint of the environment itself."""

    environment: str
    node: str
    pid: int


def of_environments(directory: Path, user: str) -> list[Process]:
    """Return the processes of all environments and nodes of a user.

    Args:
        directory: Directory of the task set.
        user: The user.
    """
    return [
        found for place in Path("/proc").iterdir() if place.name.isdigit() for found in _read(place, directory, user)
    ]


def _read(place: Path, directory: Path, user: str) -> Iterator[Process]:
    with suppress(OSError):
        command = (place / "cmdline").read_bytes()
        if not command:
            return  # a zombie
        inside = f"{directory}/environments/{user}/".encode()
        match = _node.search(command)
        if match is not None and inside in command:
            yield Process(match[1].decode(), match[2].decode(), int(place.name))
        elif ENDPOINT in command:
            variables = dict(
                each.split(b"=", 1) for each in (place / "environ").read_bytes().split(b"\0") if b"=" in each
            )
            name = variables.get(b"RCE_NAME", b"").decode()
            if variables.get(b"RCE_DATA_DIR", b"").startswith(inside) and name.startswith(f"{user}/"):
                yield Process(name.partition("/")[2], "", int(place.name))


def kill_all(directory: Path) -> int:
    """Kill all processes that have a directory on their command line or among their variables; return their number."""
    count = 0
    for place in Path("/proc").iterdir():
        if place.name.isdigit() and int(place.name) != os.getpid():
            with suppress(OSError):
                if str(directory).encode() in (place / "cmdline").read_bytes() + (place / "environ").read_bytes():
                    os.kill(int(place.name), signal.SIGKILL)
                    count += 1
    return count


def age(pid: int) -> float:
    """Return how many seconds a process has run, 0 if there is none."""
    with suppress(OSError):
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return time.clock_gettime(time.CLOCK_BOOTTIME) - int(fields[19]) / TICKS  # proc(5): starttime is field 22
    return 0.0
