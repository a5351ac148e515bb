"""Lists as they are printed."""

from __future__ import annotations

import io
import sys

import pytest

from rce.console import show

BOLD = "\x1b[1mNAME  TEXT\x1b[0m"
COLUMNS: show.Columns[tuple[str, str]] = {"name": lambda each: each[0], "text": lambda each: each[1]}


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def drawn(monkeypatch: pytest.MonkeyPatch, *rows: tuple[str, str]) -> list[str]:
    """The lines on a terminal of 20 columns."""
    terminal = Terminal()
    for name, value in {"COLUMNS": "20", "TERM": "xterm", "NO_COLOR": "1"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "stdout", terminal)
    show.rows(rows, COLUMNS)
    return terminal.getvalue().splitlines()


def test_what_fits_is_columns_of_text_without_rich(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rich.console", None)
    assert drawn(monkeypatch, ("a", "12345"), ("long", "1")) == [BOLD, "a     12345", "long  1"]


@pytest.mark.parametrize("cell", ["0123456789abcdef", "機械", "\x07bell"])
def test_what_does_not_or_is_not_plain_is_drawn_by_rich(cell: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rich", reason="needs the extra `console`")
    titles, *lines = drawn(monkeypatch, ("a", cell), ("long", "1"))
    assert titles != BOLD
    assert max(map(len, lines)) <= 20
    assert "".join(line[6:].strip() for line in lines) == cell.strip("\x07") + "1"


def test_elsewhere_all_is_plain(capsys: pytest.CaptureFixture[str]) -> None:
    show.rows([("a", "0123456789" * 20)], COLUMNS)
    assert capsys.readouterr().out.splitlines() == ["NAME  TEXT", "a     " + "0123456789" * 20]


def test_a_narrow_terminal_loses_what_says_nothing_and_breaks_no_title(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setenv("COLUMNS", "30")
    monkeypatch.setattr(sys, "stdout", terminal)
    columns: show.Columns[str] = {"environment": str, "interfaces": lambda each: None, "machine": lambda each: "m" * 20}
    show.rows(["brain"], columns)
    assert "INTERFACES" not in terminal.getvalue()
    titles, *lines = terminal.getvalue().splitlines()
    assert "ENVIRONMENT" in titles
    assert "MACHINE" in titles
    assert max(map(len, lines)) <= 30
