"""Type of the output of nodes and environments."""

from __future__ import annotations

from msgspec import Struct


class LogLines(Struct, frozen=True):
    """Lines of output, each truncated to 1000 characters. `next` is the value of `?after=` for the lines that follow.

    With `follow`, this is the data of each event of the stream, and `next` its id.
    """

    lines: list[str]
    next: str = ""
