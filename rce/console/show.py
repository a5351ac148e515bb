"""How what was found is printed: tables for people, JSON for programs."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from importlib.util import find_spec
from shutil import get_terminal_size
from typing import Any, TypeVar

import msgspec

GAP = "  "
T = TypeVar("T")
TIMES = frozenset({"created", "expires", "used"})  # names of fields that are seconds since 1970
AMOUNTS = frozenset({"memory", "disk", "bandwidth", "io", "read", "write", "package_bytes"})  # of bytes, or in a second
Columns = Mapping[str, Callable[[T], object]]
"""What stands in each column, by its title."""


def rows(items: Iterable[T], columns: Columns[T], as_json: bool = False) -> None:
    """A list as columns of text, which scripts can cut; on a terminal, where they do not fit, with rich's tables."""
    if as_json:
        print(text(list(items)))
        return
    titles = [title.upper() for title in columns]
    table = [titles, *([said(cell(item)) for cell in columns.values()] for item in items)]
    if len(table) == 1:
        print("none", file=sys.stderr)
    elif not sys.stdout.isatty() or _fits(table):
        _plain(table)
    else:
        _narrow(_told(table))


def text(item: Any) -> str:
    """Its JSON."""
    return msgspec.json.encode(item).decode()


def one(item: Any, as_json: bool = False) -> None:
    """One thing with all of its fields, those without a value left out."""
    if as_json:
        print(text(item))
        return
    given = _given(msgspec.to_builtins(item))
    width = max(map(len, given), default=0)
    for name, value in given.items():
        print(f"{name:{width}}  {_field(name, value)}")


def _given(fields: dict[str, Any]) -> dict[str, Any]:
    """Those that have a value, themselves or in them."""
    kept = {name: _given(value) if isinstance(value, dict) else value for name, value in fields.items()}
    return {name: value for name, value in kept.items() if value not in (None, "", [], {})}


def _field(name: str, value: Any) -> str:
    """A value as its field's name says that it is meant: a time, an amount, or as it is."""
    if name in TIMES:
        return when(value)
    if name.removeprefix("default_").removeprefix("total_") in AMOUNTS and isinstance(value, int):
        return amount(value)
    return said(value)


def said(value: object) -> str:
    """A value in a cell."""
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
            return ", ".join(map(said, value)) or "-"
        case dict():
            return ", ".join(f"{name}={_field(name, each)}" for name, each in _given(value).items()) or "-"
    return said(msgspec.to_builtins(value))


def amount(value: float | None, unit: str = "B") -> str:
    """Bytes and the like with a prefix of 1024; nothing for 0, which stands for no limit."""
    if not value:
        return "-"
    for prefix in ("", "Ki", "Mi", "Gi"):
        if value < 1024:
            return f"{value:.4g} {prefix}{unit}"
        value /= 1024
    return f"{value:.4g} Ti{unit}"


def when(seconds: float | None, never: str = "-") -> str:
    """A time, seconds since 1970, by this machine's clock."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(seconds)) if seconds else never


def _fits(table: list[list[str]]) -> bool:
    """Whether columns of text look as rich's would on this terminal. Rich needs 0.15 s for 200 rows."""
    simple = all(cell.isascii() and cell.isprintable() for row in table for cell in row)
    return simple and sum(_widths(table)) + len(GAP) * (len(table[0]) - 1) <= get_terminal_size().columns


def _widths(table: list[list[str]]) -> list[int]:
    return [max(map(len, column)) for column in zip(*table, strict=True)]


def _plain(table: list[list[str]]) -> None:
    widths = _widths(table)
    titles, *rest = (
        GAP.join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in table
    )
    bold = sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    print("\n".join([f"\x1b[1m{titles}\x1b[0m" if bold else titles, *rest]))


def _told(table: list[list[str]]) -> list[list[str]]:
    """Without the columns in which nothing stands."""
    columns = [column for column in zip(*table, strict=True) if {*column[1:]} != {"-"}]
    return [list(row) for row in zip(*columns, strict=True)]


def _narrow(table: list[list[str]]) -> None:
    """Broken within cells, but never within titles: where not even these fit, the terminal breaks the lines."""
    titles_fit = sum(map(len, table[0])) + len(GAP) * (len(table[0]) - 1) <= get_terminal_size().columns
    if _fits(table) or not titles_fit or not find_spec("rich"):
        _plain(table)
    else:
        _rich(*table)


def _rich(titles: list[str], *table: list[str]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    shown = Table(box=None, pad_edge=False, header_style="bold")
    for title in titles:
        shown.add_column(title, overflow="fold", min_width=len(title))
    for row in table:
        shown.add_row(*map(Text, row))  # a cell is text, never rich's markup
    Console().print(shown)
