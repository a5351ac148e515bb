"""Output of commands: tables for people, JSON for programs."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from shutil import get_terminal_size
from typing import Any, TypeVar

import msgspec

from rce.cli import layout

T = TypeVar("T")
# Seconds since 1970, unless they are whole numbers.
TIME_FIELDS = frozenset({"created", "modified", "expires", "used", "time"})
SIZE_FIELDS = frozenset(
    {"memory", "disk", "bandwidth", "io", "read", "write", "package_bytes", "recording_bytes"}
)  # bytes, or bytes/s
Columns = Mapping[str, Callable[[T], object]]
"""Functions that return the value of each column, by the column's title."""


def print_table(items: Iterable[T], columns: Columns[T], as_json: bool = False) -> None:
    """Print a list as plain columns, which scripts can cut; on a terminal, fitted to its width."""
    if as_json:
        print(to_json(list(items)))
        return
    titles = [title.upper() for title in columns]
    table = [titles, *([cell_text(cell(item)) for cell in columns.values()] for item in items)]
    if len(table) == 1:
        print("none", file=sys.stderr)
    elif sys.stdout.isatty():
        _print_fitted(table)
    else:
        print("\n".join(layout.plain(table)))


def to_json(item: Any) -> str:
    """Return a value as JSON."""
    return msgspec.json.encode(item).decode()


def print_record(item: Any, as_json: bool = False) -> None:
    """Print one object, a line for each field that has a value."""
    if as_json:
        print(to_json(item))
        return
    fields = _without_empty(msgspec.to_builtins(item))
    width = max(map(len, fields), default=0)
    for name, value in fields.items():
        print(hanging(f"{name:{width}}{layout.COLUMN_GAP}", _field_text(name, value)))


def hanging(start: str, text: str) -> str:
    """Return a text that follows a start; on a terminal its lines are wrapped and begin below each other."""
    if not sys.stdout.isatty():
        return start + text
    room = max(get_terminal_size().columns - len(start), layout.MIN_ROOM)
    return start + f"\n{' ' * len(start)}".join(layout.wrap(layout.printable(text), room))


def _without_empty(fields: dict[str, Any]) -> dict[str, Any]:
    """Return the fields that have a value, also within nested objects."""
    kept = {name: _without_empty(value) if isinstance(value, dict) else value for name, value in fields.items()}
    return {name: value for name, value in kept.items() if value not in (None, "", [], {})}


def _field_text(name: str, value: Any) -> str:
    """Return a field's value as text; the field's name tells times and sizes from other numbers."""
    if name in TIME_FIELDS and not isinstance(value, int):  # of machines, `used` is a number of slots
        return local_time(value)
    if name.removeprefix("default_").removeprefix("total_") in SIZE_FIELDS and isinstance(value, int):
        return size_text(value)
    return cell_text(value)


def cell_text(value: object) -> str:
    """Return a value as the text of a cell, `-` if it is empty."""
    match value:
        case None | "":
            return "-"
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:g}"
        case str() | int():
            return str(value)
        case list() | tuple():
            return ", ".join(map(cell_text, value)) or "-"
        case dict():
            fields = _without_empty(value)
            return ", ".join(f"{name}={_field_text(name, each)}" for name, each in fields.items()) or "-"
    return cell_text(msgspec.to_builtins(value))


def size_text(value: float | None, unit: str = "B") -> str:
    """Return a number of bytes with a binary prefix, or `-` for None."""
    if value is None:
        return "-"
    for prefix in ("", "Ki", "Mi", "Gi"):
        if value < 1024:
            return f"{value:.4g} {prefix}{unit}"
        value /= 1024
    return f"{value:.4g} Ti{unit}"


def local_time(seconds: float | None, never: str = "-") -> str:
    """Return a time given in seconds since 1970 in this machine's time zone, or `never` for None and 0."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(seconds)) if seconds else never


def _print_fitted(table: list[list[str]]) -> None:
    """Print a table in the width of the terminal."""
    fitted = layout.fit([[layout.printable(cell) for cell in row] for row in table], get_terminal_size().columns)
    bold = os.environ.get("TERM", "dumb") != "dumb"
    for number, line in enumerate(fitted.lines):
        print(f"\x1b[1m{line}\x1b[0m" if bold and number < fitted.title_lines else line)
    if fitted.left_out:
        print(f"left out: {', '.join(fitted.left_out)} (the terminal is too narrow)", file=sys.stderr)
