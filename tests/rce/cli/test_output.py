"""Printed tables and records."""

from __future__ import annotations

import io
import sys

import pytest

from rce.cli import output
from rce.protocol.messages import ContainerData, Rates

BOLD = "\x1b[1mNAME  TEXT\x1b[0m"
COLUMNS: output.Columns[tuple[str, str]] = {"name": lambda each: each[0], "text": lambda each: each[1]}


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def printed(monkeypatch: pytest.MonkeyPatch, *rows: tuple[str, str]) -> list[str]:
    """Return the lines printed on a terminal of 20 columns."""
    terminal = Terminal()
    for name, value in {"COLUMNS": "20", "TERM": "xterm", "NO_COLOR": "1"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "stdout", terminal)
    output.print_table(rows, COLUMNS)
    return terminal.getvalue().splitlines()


def test_table_that_fits_is_plain_text_without_rich(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rich.console", None)
    assert printed(monkeypatch, ("a", "12345"), ("long", "1")) == [BOLD, "a     12345", "long  1"]


@pytest.mark.parametrize("cell", ["0123456789abcdef", "機械", "\x07bell"])
def test_table_that_is_too_wide_or_not_ascii_is_printed_by_rich(cell: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rich", reason="needs the extra `console`")
    titles, *lines = printed(monkeypatch, ("a", cell), ("long", "1"))
    assert titles != BOLD
    assert max(map(len, lines)) <= 20
    assert "".join(line[6:].strip() for line in lines) == cell.strip("\x07") + "1"


def test_output_to_a_pipe_is_plain_text_of_any_width(capsys: pytest.CaptureFixture[str]) -> None:
    output.print_table([("a", "0123456789" * 20)], COLUMNS)
    assert capsys.readouterr().out.splitlines() == ["NAME  TEXT", "a     " + "0123456789" * 20]


def test_narrow_terminal_omits_empty_columns_and_keeps_titles_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setenv("COLUMNS", "30")
    monkeypatch.setattr(sys, "stdout", terminal)
    columns: output.Columns[str] = {
        "environment": str,
        "interfaces": lambda each: None,
        "machine": lambda each: "m" * 20,
    }
    output.print_table(["brain"], columns)
    assert "INTERFACES" not in terminal.getvalue()
    titles, *lines = terminal.getvalue().splitlines()
    assert "ENVIRONMENT" in titles
    assert "MACHINE" in titles
    assert max(map(len, lines)) <= 30


def test_record_is_printed_with_times_and_sizes(capsys: pytest.CaptureFixture[str]) -> None:
    data = ContainerData(memory=2**30, io=Rates(read=2**20))
    created = 86400.0 * 365
    output.print_record(
        {"created": created, "containerData": data, "total_memory": 3 * 2**30, "robots": 0, "empty": ""}
    )
    assert capsys.readouterr().out.splitlines() == [
        f"created        {output.local_time(created)}",
        "containerData  memory=1 GiB, io=read=1 MiB",
        "total_memory   3 GiB",
        "robots         0",
    ]


def test_record_without_values_prints_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    output.print_record({"containerData": ContainerData()})
    assert capsys.readouterr().out == ""
