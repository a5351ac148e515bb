"""The output of nodes and environments."""

from __future__ import annotations

from msgspec import Struct


class LogLines(Struct, frozen=True):
    """Lines of output, each cut to 1000 characters. `next` goes into `?after=` for the lines that come later.

    With `follow`, each event of the stream has one of these, and its id is `next`.
    """

    lines: list[str]
    next: str = ""
