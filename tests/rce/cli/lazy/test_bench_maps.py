"""`rce bench` for maps: what is refused before a platform is started, and what is printed."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from rce.bench import parallel_maps
from rce.cli.execute import FAILURE, SUCCESS, run
from rce.cli.lazy import bench_maps
from rce.mapping.scans import Scan
from tests.support.console import ACCESS

FLASER = "FLASER 3 1.0 1.0 1.0 0 0 0 0 0 0 {0}.0 host {0}.0\n"


@pytest.fixture
def no_platform(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail if a platform is started."""

    def platform(*words: object, **options: object) -> None:
        raise AssertionError("a platform is started")

    monkeypatch.setattr(bench_maps, "own_platform", platform)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "a.log"
    path.write_text("".join(FLASER.format(second) for second in range(1, 31)))
    return path


@pytest.mark.usefixtures("no_platform")
@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("map a.log --mappers graph,guess", "there is no mapper guess: it is one of graph, particle"),
        ("map a.log --workers 1,17", "--workers are at most 16"),
        ("map a.log --workers 2 --cut 0", "--cut is at least 1"),
        ("endless a.log --mappers guess", "there is no mapper guess"),
    ],
)
def test_wrong_option_is_refused_before_a_platform_is_started(
    line: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["bench", *line.split()]) == FAILURE
    assert reason in capsys.readouterr().err


def test_workers_map_all_recordings_together(
    log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    @asynccontextmanager
    async def entered(*words: object, **options: object) -> AsyncIterator[Any]:
        yield ACCESS

    async def measure(robot: object, recordings: Sequence[Sequence[Scan]], workers: Sequence[int]) -> Any:
        assert (len(recordings), workers) == (3, [1, 2])
        figure = parallel_maps.Figure(1, 2.0, 1.0, 1, [])
        return parallel_maps.Result(3, sum(map(len, recordings)), [figure], [])

    monkeypatch.setattr(bench_maps, "own_platform", entered)
    monkeypatch.setattr(bench_maps, "Robot", entered)
    monkeypatch.setattr(parallel_maps, "measure", measure)
    assert run(["bench", "map", str(log), "--workers", "1,2", "--cut", "3"]) == SUCCESS
    assert capsys.readouterr().out.startswith("3 recordings, 36 scans; ")
