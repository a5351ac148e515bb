"""Readiness announcement: the line by which a program tells its parent process that it is ready, and its addresses."""

from __future__ import annotations

import sys

import msgspec


class Ready(msgspec.Struct, omit_defaults=True):
    """Announcement that a program is ready.

    Attributes:
        program: Name of the program.
        url: Its URL for users.
        control: Its control port for other processes, as a Twisted client endpoint.
    """

    program: str
    url: str = ""
    control: str = ""


def announce(ready: Ready) -> None:
    """Print the announcement on standard output, which has no log lines."""
    sys.stdout.write(msgspec.json.encode(ready).decode() + "\n")
    sys.stdout.flush()


def parse(line: bytes) -> Ready | None:
    """Decode the announcement in a line of a program's output; return None if the line is none."""
    try:
        return msgspec.json.decode(line, type=Ready)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
