"""Output of commands: tables for people, JSON for programs."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from importlib.util import find_spec
from shutil import get_terminal_size
from typing import Any, TypeVar

import msgspec

COLUMN_GAP = "  "
T = TypeVar("T")
TIME_FIELDS = frozenset({"created", "expires", "used"})  # seconds since 1970
SIZE_FIELDS = frozenset({"memory", "disk", "bandwidth", "io", "read", "write", "package_bytes"})  # bytes, or bytes/s
Columns = Mapping[str, Callable[[T], object]]
"""Functions that return the value of each column, by the column's title."""


def print_table(items: Iterable[T], columns: Columns[T], as_json: bool = False) -> None:
    """Print a list as plain columns, which scripts can cut; on a terminal too narrow for these, as a table of rich."""
    if as_json:
        print(to_json(list(items)))
        return
    titles = [title.upper() for title in columns]
    table = [titles, *([cell_text(cell(item)) for cell in columns.values()] for item in items)]
    if len(table) == 1:
        print("none", file=sys.stderr)
    elif not sys.stdout.isatty() or _fits(table):
        _print_plain(table)
    else:
        _print_narrow(_without_empty_columns(table))


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
        print(f"{name:{width}}  {_field_text(name, value)}")


def _without_empty(fields: dict[str, Any]) -> dict[str, Any]:
    """Return the fields that have a value, also within nested objects."""
    kept = {name: _without_empty(value) if isinstance(value, dict) else value for name, value in fields.items()}
    return {name: value for name, value in kept.items() if value not in (None, "", [], {})}


def _field_text(name: str, value: Any) -> str:
    """Return a field's value as text; the field's name tells times and sizes from other numbers."""
    if name in TIME_FIELDS:
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
    """Return a number of bytes with a binary prefix, or `-` for 0, which stands for no limit."""
    if not value:
        return "-"
    for prefix in ("", "Ki", "Mi", "Gi"):
        if value < 1024:
            return f"{value:.4g} {prefix}{unit}"
        value /= 1024
    return f"{value:.4g} Ti{unit}"


def local_time(seconds: float | None, never: str = "-") -> str:
    """Return a time given in seconds since 1970 in this machine's time zone, or `never` for None and 0."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(seconds)) if seconds else never


def _fits(table: list[list[str]]) -> bool:
    """Return True if plain columns look as rich's table would. Rich takes 0.15 s for 200 rows."""
    simple = all(cell.isascii() and cell.isprintable() for row in table for cell in row)
    return simple and sum(_widths(table)) + len(COLUMN_GAP) * (len(table[0]) - 1) <= get_terminal_size().columns


def _widths(table: list[list[str]]) -> list[int]:
    return [max(map(len, column)) for column in zip(*table, strict=True)]


def _print_plain(table: list[list[str]]) -> None:
    widths = _widths(table)
    titles, *rest = (
        COLUMN_GAP.join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in table
    )
    bold = sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    print("\n".join([f"\x1b[1m{titles}\x1b[0m" if bold else titles, *rest]))


def _without_empty_columns(table: list[list[str]]) -> list[list[str]]:
    columns = [column for column in zip(*table, strict=True) if {*column[1:]} != {"-"}]
    return [list(row) for row in zip(*columns, strict=True)]


def _print_narrow(table: list[list[str]]) -> None:
    """Print lines broken within cells but never within titles; where these do not fit either, the terminal breaks."""
    titles_fit = sum(map(len, table[0])) + len(COLUMN_GAP) * (len(table[0]) - 1) <= get_terminal_size().columns
    if _fits(table) or not titles_fit or not find_spec("rich"):
        _print_plain(table)
    else:
        _print_rich(*table)


def _print_rich(titles: list[str], *rows: list[str]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in titles:
        table.add_column(title, overflow="fold", min_width=len(title))
    for row in rows:
        table.add_row(*map(Text, row))  # Text: rich would interpret markup in strings
    Console().print(table)
