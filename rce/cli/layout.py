"""Layout of tables and texts for the width of a terminal."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from typing import NamedTuple

COLUMN_GAP = "  "
MIN_ROOM = 20  # characters for a text beside names that leave less
BREAKS = re.compile(r"(?<=\s)(?=\S)(?!(?:[KMGT]i)?B\b)|(?<=[/,])(?=[^\s/,]{2})")
"""Places to break a text: at blanks, but not between a size and its unit, and after `/` and `,` in long names."""


class Layout(NamedTuple):
    """Lines of a table, the titles in the first `title_lines`, and the titles of the columns left out."""

    lines: list[str]
    title_lines: int
    left_out: list[str]


def fit(table: Sequence[Sequence[str]], width: int) -> Layout:
    """Fit a table, whose first row has the titles, into lines of `width` characters.

    A table that is too wide loses its empty columns. Then cells are wrapped at word boundaries, and where that is not
    enough, columns are left out from the right. The first column, which has the names, is wrapped last of all.
    """
    if _total(_widths(table)) > width:
        table = _without_empty_columns(table)
    columns, natural = _columns(table), _widths(table)
    if _total(natural) <= width:
        return Layout(plain(table), 1, [])
    longest = max(width // 2, 1)  # no column needs more; longer words are broken
    least = [min(max(map(_longest_word, column)), longest) for column in columns]
    least[0] = min(natural[0], longest)
    count = len(columns)
    while count > 1 and _total(least[:count]) > width:
        count -= 1
    room = width - len(COLUMN_GAP) * (count - 1)
    widths = _share(least[:count], natural[:count], room)
    blocks = [_row_lines(row[:count], widths) for row in table]
    lines = [line for block in blocks for line in block]
    return Layout(lines, len(blocks[0]), list(table[0][count:]))


def plain(table: Sequence[Sequence[str]]) -> list[str]:
    """Return a line for each row, with columns as wide as their widest cells."""
    widths = _widths(table)
    return [_join(row, widths) for row in table]


def wrap(text: str, width: int) -> list[str]:
    """Break a text at word boundaries into lines of `width` characters; only words that are longer are broken."""
    lines = [""]
    for word in BREAKS.split(text):
        if text_width(lines[-1] + word.rstrip()) <= width:
            lines[-1] += word
            continue
        rest = word.rstrip()
        while text_width(rest) > width:
            start = _prefix(rest, width)
            lines.append(start)
            rest = rest[len(start) :]
        lines.append(rest + word[len(word.rstrip()) :])
    return [line.rstrip() for line in (lines if lines[0].strip() or len(lines) == 1 else lines[1:])]


def text_width(text: str) -> int:
    """Return the number of a terminal's columns that a text takes."""
    if text.isascii():
        return len(text)
    return sum(map(_character_width, text))


def printable(text: str) -> str:
    """Return a text with blanks for line ends and tabs, and without other characters that control a terminal."""
    if text.isprintable():
        return text
    kept = (" " if each.isspace() else each for each in text)
    return "".join(each for each in kept if each == " " or unicodedata.category(each) != "Cc")


def _character_width(character: str) -> int:
    if unicodedata.category(character) in ("Mn", "Me", "Cf"):
        return 0
    return 2 if unicodedata.east_asian_width(character) in ("W", "F") else 1


def _prefix(text: str, width: int) -> str:
    """Return the longest beginning of a text that fits, at least one character."""
    length = 1
    while length < len(text) and text_width(text[: length + 1]) <= width:
        length += 1
    return text[:length]


def _columns(table: Sequence[Sequence[str]]) -> list[tuple[str, ...]]:
    return list(zip(*table, strict=True))


def _widths(table: Sequence[Sequence[str]]) -> list[int]:
    return [max(map(text_width, column)) for column in _columns(table)]


def _without_empty_columns(table: Sequence[Sequence[str]]) -> list[tuple[str, ...]]:
    columns = [column for number, column in enumerate(_columns(table)) if not number or {*column[1:]} != {"-"}]
    return list(zip(*columns, strict=True))


def _longest_word(cell: str) -> int:
    return max(text_width(word.rstrip()) for word in BREAKS.split(cell))


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + len(COLUMN_GAP) * (len(widths) - 1)


def _share(least: Sequence[int], natural: Sequence[int], room: int) -> list[int]:
    """Give each column its least width and then, in equal parts, what is left of the room, up to its natural width."""
    widths = list(least)
    while sum(widths) < room:
        growing = [number for number, width in enumerate(widths) if width < natural[number]]
        if not growing:
            break
        for number in growing[: room - sum(widths)]:
            widths[number] += 1
    return widths


def _row_lines(row: Sequence[str], widths: Sequence[int]) -> list[str]:
    cells = [wrap(cell, width) for cell, width in zip(row, widths, strict=True)]
    height = max(map(len, cells))
    padded = [cell + [""] * (height - len(cell)) for cell in cells]
    return [_join(line, widths) for line in zip(*padded, strict=True)]


def _join(cells: Sequence[str], widths: Sequence[int]) -> str:
    padded = (cell + " " * (width - text_width(cell)) for cell, width in zip(cells, widths, strict=True))
    return COLUMN_GAP.join(padded).rstrip()
