"""Log of `rce up` at a terminal."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest

from rce.process import terminal_log as module
from rce.process.terminal_log import shown_text, terminal_log


def line(level: str, message: str) -> str:
    return json.dumps({"time": "2030-01-31T08:00:01.5+00:00", "level": level, "from": "master", "message": message})


@pytest.mark.parametrize(
    ("logged", "shown"),
    [
        (line("info", "machine-1 joined"), ""),
        (line("debug", "a call"), ""),
        (line("warn", "robot r1 sends nonsense"), "08:00:01 warn: robot r1 sends nonsense"),
        (line("error", "disk full"), "08:00:01 error: disk full"),
        ("rce robot ended with status 1: restarting it", "rce robot ended with status 1: restarting it"),
    ],
)
def test_terminal_shows_what_concerns_the_user(logged: str, shown: str) -> None:
    assert shown_text(logged + "\n") == shown


def test_file_has_everything(tmp_path: Path) -> None:
    terminal = io.StringIO()
    with terminal_log(tmp_path / "new" / "up.log", terminal) as log:
        print(line("info", "quiet"), file=log)
        print(line("error", "loud"), file=log)
    assert terminal.getvalue() == "08:00:01 error: loud\n"
    assert [json.loads(each)["message"] for each in (tmp_path / "new" / "up.log").open()] == ["quiet", "loud"]


def test_large_file_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_SIZE", 10)
    with terminal_log(tmp_path / "up.log", io.StringIO()) as log:
        for number in range(3):
            print(f"a line of some length {number}", file=log)
    assert (tmp_path / "up.log").read_text() == "a line of some length 2\n"
    assert (tmp_path / "up.log.1").read_text() == "a line of some length 1\n"
