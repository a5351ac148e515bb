"""The server programs, which this package does not import: found by entry points, run as processes of their own."""

from __future__ import annotations

import os
import sys
from importlib.metadata import entry_points
from importlib.util import find_spec
from typing import NoReturn

from rce.errors import NotFound

GROUP = "rce.programs"
NEEDS = {"image": ("docker", "server,docker")}
"""What a program cannot be started without, and the extra that brings it."""


def command(name: str) -> list[str]:
    """The command line that starts a program. `-P` keeps the current directory off its import path."""
    library, extra = NEEDS.get(name, ("twisted", "server"))
    for entry in entry_points(group=GROUP, name=name) if find_spec(library) else ():
        return [sys.executable, "-P", "-m", entry.value.removesuffix(".__main__")]
    raise NotFound(f"the program {name} is not installed: pip install '.[{extra}]' in a checkout of RCE")


def installed(name: str, *needs: str) -> bool:
    """Whether a program is there with the libraries that it needs."""
    return name in known() and all(find_spec(library) is not None for library in needs)


def become(name: str, arguments: list[str]) -> NoReturn:
    """Go on as this program."""
    words = command(name) + arguments
    os.execv(words[0], words)


def known() -> list[str]:
    return sorted(entry.name for entry in entry_points(group=GROUP))
