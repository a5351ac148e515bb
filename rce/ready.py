"""One line by which a started program tells who started it that it can be used, and where."""

from __future__ import annotations

import sys

import msgspec


class Ready(msgspec.Struct, omit_defaults=True):
    """`program` can be used: `url` for its users, `control` as a Twisted client endpoint for its peers."""

    program: str
    url: str = ""
    control: str = ""


def announce(ready: Ready) -> None:
    """Print the line on standard output, where logs never go."""
    sys.stdout.write(msgspec.json.encode(ready).decode() + "\n")
    sys.stdout.flush()


def parse(line: bytes) -> Ready | None:
    """The announcement in a line of a program's output, if it is one."""
    try:
        return msgspec.json.decode(line, type=Ready)
    except msgspec.DecodeError:
        return None
