"""`rce bench` for many robots and failures: what is refused before a platform is started, and what is printed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from rce.bench.chaos.report import Result
from rce.bench.chaos.run import Plan
from rce.cli.execute import FAILURE, SUCCESS, run
from rce.cli.lazy import bench_scale


@pytest.fixture
def no_platform(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail if a platform is started."""

    def platform(*words: object, **options: object) -> None:
        raise AssertionError("a platform is started")

    monkeypatch.setattr(bench_scale, "own_platform", platform)


@pytest.mark.usefixtures("no_platform")
@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("chaos --minutes 0", "--minutes and --events must be positive"),
        ("chaos --events 0", "--minutes and --events must be positive"),
        ("control --robots 1,many", "--robots is a list of numbers such as 1,20"),
        ("control --count 0", "--count must be at least 1"),
    ],
)
def test_wrong_number_is_refused_before_a_platform_is_started(
    line: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["bench", *line.split()]) == FAILURE
    assert reason in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--robots", "--interfaces", "--samples"])
def test_crowd_without_members_is_refused(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("playwright", reason="needs the extra `bench`")
    assert run(["bench", "dashboard", option, "0"]) == FAILURE
    assert "must be at least 1" in capsys.readouterr().err


@pytest.mark.usefixtures("no_platform")
@pytest.mark.parametrize("option", ["--minutes", "--rate"])
def test_soak_without_visitors_is_refused(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("psutil", reason="needs the extra `bench`")
    assert run(["bench", "soak", option, "0"]) == FAILURE
    assert "must be positive" in capsys.readouterr().err


def test_chaos_prints_its_figures_and_removes_its_directory(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    directories = []

    async def measure(directory: Path, plan: Plan, progress: Callable[[int, int], None]) -> Result:
        directories.append(directory)
        assert plan == Plan(7, 60, 120.0)
        return Result(plan.seed, 1.0, {"Master killed": 1}, 5, {}, [0.1], {"Master killed": [1.5]}, [], disks=False)

    monkeypatch.setattr("rce.bench.chaos.run.measure", measure)
    assert run(["bench", "chaos", "--seed", "7", "--events", "60", "--minutes", "2"]) == SUCCESS
    assert "Master killed       1         1.50 s  1.50 s" in capsys.readouterr().out
    assert not directories[0].exists()
