"""Lists on a terminal, shares of the processor, and the report."""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("playwright", reason="needs the extra `bench`")
pytest.importorskip("psutil", reason="needs the extra `bench`")

import psutil

from rce.bench import dashboard
from rce.bench.crowd import Crowded
from rce.bench.dashboard import TERMINAL, List, Result
from rce.errors import NotFound, StartFailed

RESULT = Result(20, 200, [0.4, 0.6, 0.5], 0.023, 0.086, 0.031, {"env list": List([0.2, 0.3, 0.1], [0.11, 0.12, 0.1])})


def test_first_installed_browser_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(NotFound, match="install one of chromium, "):
        dashboard.browser()
    for name in ("google-chrome", "chromium-browser"):
        (tmp_path / name).touch(mode=0o755)
    assert dashboard.browser() == str(tmp_path / "chromium-browser")


def test_command_runs_on_a_terminal_of_the_usual_size(tmp_path: Path) -> None:
    out = tmp_path / "size"
    code = f"import os; open({str(out)!r}, 'w').write(str((os.isatty(0), *os.get_terminal_size())))"
    dashboard._run_on_terminal([sys.executable, "-c", code], os.environ)
    assert out.read_text() == str((True, TERMINAL[1], TERMINAL[0]))


def test_long_output_does_not_block_a_command() -> None:
    dashboard._run_on_terminal([sys.executable, "-c", "print('x' * 1_000_000)"], os.environ)


def test_failed_command_is_reported_with_its_output() -> None:
    with pytest.raises(StartFailed, match="there is no platform"):
        dashboard._run_on_terminal([sys.executable, "-c", "import sys; sys.exit('there is no platform')"], os.environ)


async def test_list_is_a_command_with_the_crowds_key(monkeypatch: pytest.MonkeyPatch) -> None:
    commands: list[tuple[list[str], str]] = []

    def run_on_terminal(command: list[str], environment: dict[str, str]) -> None:
        commands.append((command[4:], environment["RCE_KEY"]))

    monkeypatch.setattr(dashboard, "_run_on_terminal", run_on_terminal)
    taken = await dashboard._list(Crowded("http://a/", 1, "rce_k"), ("env", "list"), 3)
    assert commands == [(["env", "list", "--url", "http://a/"], "rce_k")] * 3
    assert (len(taken.wall), len(taken.cpu)) == (3, 3)


async def test_share_is_cpu_time_by_elapsed_time(monkeypatch: pytest.MonkeyPatch) -> None:
    spent = iter([10.0, 10.5])
    clock = iter([100.0, 102.0])
    monkeypatch.setattr(dashboard, "_spent", lambda processes: next(spent))
    monkeypatch.setattr(time, "monotonic", lambda: next(clock, 0.0))
    assert await dashboard._share([], 0) == 0.25


def test_ended_process_has_spent_nothing() -> None:
    process = psutil.Popen([sys.executable, "-c", ""])
    process.wait()
    assert dashboard._spent([process]) == 0
    assert dashboard._spent([psutil.Process()]) > 0


def test_table_has_medians_and_shares() -> None:
    title, _, *rows = dashboard.as_text(RESULT).splitlines()
    assert title.startswith("20 robots, 20 environments, 200 interfaces; ")
    shown = [" ".join(row.split()) for row in rows]
    assert shown == [
        "graph of the dashboard after a reload 0.50 s",
        "with the dashboard open: browser 2.3 % of a core",
        "Master 8.6 %",
        "without a dashboard: Master 3.1 %",
        "rce env list 200 ms 110 ms CPU",
    ]


def test_data_has_all_samples() -> None:
    data = json.loads(json.dumps(dashboard.as_data(RESULT)))["dashboard"]
    assert data["loads"] == [0.4, 0.6, 0.5]
    assert data["lists"]["env list"]["cpu"] == [0.11, 0.12, 0.1]
