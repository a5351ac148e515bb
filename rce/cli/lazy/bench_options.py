"""Options and functions that the commands of `rce bench` share."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Callable, Collection, Coroutine, Iterable, Sequence
from functools import wraps
from typing import Any, TypeVar

from rce.cli.session import ConsoleSession
from rce.errors import InvalidRequest

N = TypeVar("N", bound=str)


def coroutine_command(
    function: Callable[[argparse.Namespace], Coroutine[Any, Any, None]],
) -> Callable[[ConsoleSession, argparse.Namespace], None]:
    """Return the function of a command that runs a coroutine."""

    @wraps(function)
    def run(session: ConsoleSession, args: argparse.Namespace) -> None:
        asyncio.run(function(args))

    return run


def numbers(text: str, option: str) -> list[int]:
    """Return a list of numbers that was given as `1,20`.

    Raises:
        InvalidRequest: It is no such list, or has a number below 1.
    """
    found = [int(each) if each.isdecimal() else 0 for each in text.split(",")]
    if min(found) < 1:
        raise InvalidRequest(f"rce bench: {option} is a list of numbers such as 1,20")
    return found


def parse_names(kind: str, text: str, known: Sequence[N]) -> list[N]:
    """Return the known names in a comma-separated list.

    Raises:
        InvalidRequest: The list has another name.
    """
    given = text.split(",")
    check_names(kind, filter(None, given), known)
    return [name for name in known if name in given]


def check_names(kind: str, names: Iterable[str], known: Collection[str]) -> None:
    """Check names.

    Raises:
        InvalidRequest: A name is not known.
    """
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InvalidRequest(f"rce bench: there is no {kind} {', '.join(unknown)}: it is one of {', '.join(known)}")
