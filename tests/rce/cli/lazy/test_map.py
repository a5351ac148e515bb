"""`rce map`: options, progress and written maps, without a platform."""

from __future__ import annotations

import argparse
import io
import math
import sys
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from rce.cli.contexts import Access
from rce.cli.execute import FAILURE, SUCCESS, run
from rce.cli.lazy import map as command
from rce.cli.lazy.map import Progress, Source, Together, describe, heights, node_parameters, save_team_maps
from rce.errors import InvalidRequest
from rce.mapping.evaluation.simulation import Accuracy
from rce.mapping.files.picture import draw
from rce.mapping.grid import OccupancyGrid
from rce.mapping.parallel.job import JointMap
from rce.mapping.parallel.run import Method, ParallelRun
from rce.mapping.robot import Result
from rce.mapping.scan_cutting import Band
from rce.mapping.scans import Scan
from tests.support.console import ACCESS, Terminal

FLASER = "FLASER 3 1.0 1.0 1.0 0 0 0 0 0 0 {0}.0 host {0}.0\n"


@dataclass
class Recorded:
    """Recording without scans."""

    name: str = "a.log"
    scans: int | None = 100
    duration: float | None = 50.0

    def __iter__(self) -> Iterator[Scan]:
        return iter(())


def result(occupied: int, scans: int = 3) -> Result:
    cells = np.full((4, 4), 0, np.int8)
    cells[occupied, occupied] = 100
    return Result(OccupancyGrid(cells, 0.05, 0.0, 0.0), np.zeros((scans, 4)), scans)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "a.log"
    path.write_text("".join(FLASER.format(second) for second in range(1, 4)))
    return path


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ([], "give recordings, or --simulate"),
        (["a.log", "--simulate"], "give recordings, or --simulate"),
        (["a.log", "--team"], "--team needs several recordings and the mapper graph"),
        (["a.log", "b.log", "--team", "--mapper", "particle"], "--team needs several recordings"),
        (["a.log", "--parallel", "17"], "--parallel: 17 is not a number from 1 to 16"),
        (["a.log", "--parallel", "0"], "--parallel: 0 is not a number"),
        (["a.log", "b.log", "--parallel", "2", "--team"], "give it without --team and --simulate"),
        (["absent.log"], "absent.log"),
    ],
)
def test_wrong_options_are_refused_before_a_platform_is_started(
    options: list[str], reason: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "platform", None)
    assert run(["map", *options]) == FAILURE
    assert reason in capsys.readouterr().err


@pytest.fixture
def mapped(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the recordings that were mapped."""
    names: list[str] = []

    @asynccontextmanager
    async def platform(args: argparse.Namespace) -> AsyncIterator[Access]:
        yield ACCESS

    async def map_alone(access: Access, source: Source, parameters: object) -> Result:
        names.append(source.name)
        return result(1)

    monkeypatch.setattr(command, "platform", platform)
    monkeypatch.setattr(command, "map_alone", map_alone)
    return names


def test_single_map_is_written_to_the_directory(
    log: Path, tmp_path: Path, mapped: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "maps" / "one"
    assert run(["map", str(log), "--out", str(out)]) == SUCCESS
    assert mapped == ["a.log"]
    assert (out / "map.png").exists()
    assert capsys.readouterr().out.startswith(f"3 scans mapped; map in {out}: ")


def test_each_of_several_maps_has_a_directory_of_its_own(log: Path, tmp_path: Path, mapped: list[str]) -> None:
    other = tmp_path / "b.log"
    other.write_text(log.read_text())
    assert run(["map", str(log), str(other), "--out", str(tmp_path / "maps")]) == SUCCESS
    assert sorted(path.name for path in (tmp_path / "maps").iterdir()) == ["a.log", "b.log"]
    assert (tmp_path / "maps" / "b.log" / "map.png").exists()


def test_recordings_are_mapped_in_parallel(
    log: Path, tmp_path: Path, mapped: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each recording keeps its number, whatever the order of the maps; lost workers are told."""
    other = tmp_path / "b.log"
    other.write_text(log.read_text())
    first, second = result(1), result(2)

    @asynccontextmanager
    async def robot(*words: object, **options: object) -> AsyncIterator[None]:
        yield None

    async def run_parallel(_: None, name: str, sources: list[Source], method: Method, report: object) -> ParallelRun:
        assert (method.workers, method.mapper, method.settings.resolution) == (3, "graph", 0.1)
        assert [source.name for source in sources] == ["a.log", "b.log"]
        maps = [JointMap(second.grid, {1: second.trajectory}), JointMap(first.grid, {0: first.trajectory})]
        return ParallelRun(maps, [], 2)

    monkeypatch.setattr(command, "Robot", robot)
    monkeypatch.setattr(command.parallel, "run", run_parallel)
    words = ["map", str(log), str(other), "--parallel", "3", "--resolution", "0.1", "--out", str(tmp_path / "maps")]
    assert run(words) == SUCCESS
    said = capsys.readouterr()
    assert "2 workers were lost and replaced" in said.err
    assert f"robot 2 (b.log): 3 scans mapped, on the map in {tmp_path / 'maps' / 'map_2'}" in said.out
    assert (tmp_path / "maps" / "trajectory_1.txt").exists()


def test_scans_of_several_recordings_are_added() -> None:
    assert Together.of([Recorded("a"), Recorded("b")]) == ("a, b", 200, None)
    assert Together.of([Recorded("a"), Recorded("b", scans=None)]).scans is None


def test_robots_on_one_map_share_its_directory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_team_maps(tmp_path, [Recorded("a"), Recorded("b"), Recorded("c")], [result(1), result(2), result(1)])
    assert (tmp_path / "trajectory_1.txt").exists()
    assert (tmp_path / "trajectory_3.txt").exists()
    assert (tmp_path / "map_2" / "trajectory_2.txt").exists()
    assert (tmp_path / "map_2" / "map.png").exists()
    assert (tmp_path / "map.png").read_bytes() == draw(result(1).grid, result(1).trajectory, result(1).trajectory)
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == f"robot 2 (b): 3 scans mapped, on the map in {tmp_path / 'map_2'}"
    assert lines[3] == "2 maps: no overlap was found between robots on different maps"


def test_one_joint_map_needs_no_explanation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_team_maps(tmp_path, [Recorded("a"), Recorded("b")], [result(1), result(1)])
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_parameters_of_the_node_are_those_of_the_options() -> None:
    options = {"resolution": 0.1, "mapper": "particle", "particles": 50, "seed": 7}
    assert node_parameters(argparse.Namespace(**options, team=False)) == options


def test_accuracy_is_described_in_centimetres_and_degrees() -> None:
    text = describe(Accuracy(0.0123, math.radians(0.5), 0.987, 1.0))
    assert "1.2 cm" in text
    assert "0.50° off" in text
    assert "99% of the walls" in text
    assert "100% of the map's walls" in text


class Clock:
    """Clock in place of `time.monotonic`."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(time, "monotonic", clock)
    return clock


def test_progress_is_a_line_every_few_seconds(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    progress = Progress(Recorded())
    progress.begin()
    for count in range(1, 101):
        clock.now += 0.1
        progress.update(count)
    progress.end()
    assert capsys.readouterr().err.splitlines() == [
        "a.log: 50/100 scans, 5.0 times real time, 5 s to go, 5.0 s",
        "a.log: 100/100 scans, 5.0 times real time, 10.0 s",
        "a.log: 100/100 scans, 5.0 times real time, 10.0 s",
    ]


def test_progress_of_a_recording_of_unknown_length_counts_only(
    clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    progress = Progress(Recorded(scans=None, duration=None))
    progress.begin()
    clock.now += 5
    progress.update(9)
    assert capsys.readouterr().err == "a.log: 9 scans, 5.0 s\n"


def test_progress_on_a_terminal_stays_on_one_line(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    progress = Progress(Recorded(scans=None, duration=None))
    progress.begin()
    clock.now += 1
    progress.update(1)
    progress.end()
    lines = terminal.getvalue().split("\r")
    assert [line.strip() for line in lines] == ["", "a.log: 1 scans, 1.0 s", "a.log: 1 scans, 1.0 s"]
    assert terminal.getvalue().count("\n") == 1


class TwoTopics:
    """A recording with two topics of scans."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.scan_topics = {"/front": 5, "/rear": 3}


@pytest.mark.parametrize(
    ("given", "typed", "mapped", "asked"),
    [("", "/rear", "/rear", True), ("", "", "", True), ("/rear", None, "/rear", False), ("", None, "", False)],
)
def test_topic_of_scans_is_asked_for_at_a_terminal_if_there_are_several(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    given: str,
    typed: str | None,
    mapped: str,
    asked: bool,
) -> None:
    prompts: list[str] = []

    def answer(prompt: str) -> str:
        prompts.append(prompt)
        return typed or ""

    monkeypatch.setattr(command, "open_recording", lambda path, topic, odometry, band: TwoTopics(topic))
    monkeypatch.setattr("builtins.input", answer)
    monkeypatch.setattr(sys, "stdin", Terminal() if typed is not None else io.StringIO())
    args = argparse.Namespace(scan_topic=given, odometry_topic="", heights="-0.3,0.3")
    assert command._open(Path("a.bag"), args).topic == mapped  # type: ignore[attr-defined]  # of the fake
    assert bool(prompts) == asked
    assert ("/front (5 scans), /rear (3 scans)" in capsys.readouterr().err) == (not given)


def test_heights_are_two_numbers_in_order() -> None:
    assert heights("-0.2,0.5") == Band(-0.2, 0.5)
    for words in ("1", "a,b", "1,2,3", "0.5,0.5", "nan,1", "0,inf"):
        with pytest.raises(InvalidRequest, match="--heights"):
            heights(words)
