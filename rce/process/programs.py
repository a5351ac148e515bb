"""Server programs: found by their entry points and run as separate processes, since `rce` must not import them."""

from __future__ import annotations

import os
import sys
from importlib.metadata import entry_points
from importlib.util import find_spec
from typing import NoReturn

from rce.errors import NotFound

GROUP = "rce.programs"
REQUIREMENTS = {"image": ("docker", "server,docker"), "knowledge-service": ("rdflib", "server,knowledge")}
"""By program: the library that it needs first, and the extras that install it."""


def command(name: str) -> list[str]:
    """Return the command line that starts a program. `-P` keeps the current directory off its import path.

    Raises:
        NotFound: The program is not installed.
    """
    library, extra = REQUIREMENTS.get(name, ("twisted", "server"))
    for entry in entry_points(group=GROUP, name=name) if find_spec(library) else ():
        return [sys.executable, "-P", "-m", entry.value.removesuffix(".__main__")]
    raise NotFound(f"the program {name} is not installed: pip install '.[{extra}]' in a checkout of RCE")


def installed(name: str, *libraries: str) -> bool:
    """Return True if a program and the libraries that it needs are installed."""
    return name in installed_programs() and all(find_spec(library) is not None for library in libraries)


def exec_program(name: str, arguments: list[str]) -> NoReturn:
    """Replace this process by a program.

    Raises:
        NotFound: The program is not installed.
    """
    words = command(name) + arguments
    os.execv(words[0], words)


def installed_programs() -> list[str]:
    """Return the names of all programs whose packages are installed."""
    return sorted(entry.name for entry in entry_points(group=GROUP))
