"""`rce bench`: what is refused before a platform is started, and what is printed."""

from __future__ import annotations

import argparse
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from rce.api.client import ApiClient
from rce.bench import overtake, start
from rce.bench.nodes import Place, Probe
from rce.bench.routes import ROUTES
from rce.cli.commands.bench import QUICK_SAMPLES, QUICK_SIZES
from rce.cli.execute import FAILURE, SUCCESS, run
from rce.cli.lazy import bench
from rce.process.ready import Ready

PLACE: Any = None  # the measurements of these tests use neither robot nor environment


@pytest.fixture
def no_platform(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail if a platform is started."""

    def platform(args: argparse.Namespace) -> None:
        raise AssertionError("a platform is started")

    monkeypatch.setattr(bench, "platform", platform)
    monkeypatch.setattr(bench, "own_platform", platform)


@pytest.fixture
def place(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measure without a platform."""

    @asynccontextmanager
    async def bench_place(args: argparse.Namespace) -> AsyncIterator[Place]:
        yield PLACE

    monkeypatch.setattr(bench, "_bench_place", bench_place)


@pytest.mark.usefixtures("no_platform")
@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("rtt --routes n2n,c2x", "there is no route c2x: it is one of tcp, "),
        ("start --engines process,cloud", "there is no engine cloud: it is one of process, docker, swarm"),
        ("rtt --sizes 1", "the number of sizes is 1"),
    ],
)
def test_unknown_name_is_refused_before_a_platform_is_started(
    line: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["bench", *line.split()]) == FAILURE
    assert reason in capsys.readouterr().err


@pytest.fixture
def sampled(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of the samples of the route tcp, which takes a millisecond for each."""
    sizes: list[int] = []

    async def sample(size: int) -> float:
        sizes.append(size)
        return 0.001

    async def tcp(place: Place) -> list[Probe]:
        return [Probe("tcp", "topic", sample)]

    monkeypatch.setitem(ROUTES, "tcp", tcp)
    monkeypatch.setattr("rce.bench.run.PAUSE", (0.0, 0.0))
    return sizes


@pytest.mark.usefixtures("place")
@pytest.mark.parametrize(
    ("options", "sizes", "samples"),
    [("--quick", QUICK_SIZES, QUICK_SAMPLES), ("--sizes 2 --samples 4", 2, 4)],
)
def test_round_trips_of_the_chosen_route_are_printed(
    options: str, sizes: int, samples: int, sampled: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["bench", "rtt", "--routes", "tcp", "--json", *options.split()]) == SUCCESS
    (series,) = json.loads(capsys.readouterr().out)["series"]
    assert [len(taken) for taken in series["seconds"].values()] == [samples] * sizes
    assert len(sampled) == sizes * (samples + 1)


@pytest.mark.slow
@pytest.mark.usefixtures("place", "sampled")
def test_round_trips_are_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib", reason="needs the extra `bench`")
    picture = tmp_path / "rtt.svg"
    assert run(["bench", "rtt", "--routes", "tcp", "--quick", "--plot", str(picture)]) == SUCCESS
    assert "<svg" in picture.read_text()
    assert "1.00" in capsys.readouterr().out


@pytest.mark.usefixtures("place")
@pytest.mark.parametrize(("options", "parse"), [(["--json"], json.loads), ([], str)])
def test_commands_beside_images_are_printed(
    options: list[str],
    parse: Callable[[str], Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    async def measure(place: Place, samples: int) -> overtake.Result:
        taken = [overtake.Command(0.001, 0.002)] * samples
        return overtake.Result(taken, taken, 12.0)

    monkeypatch.setattr(overtake, "measure", measure)
    assert run(["bench", "overtake", "--samples", "3", *options]) == SUCCESS
    printed = parse(capsys.readouterr().out)
    if options:
        assert printed["overtake"]["alone"] == [[0.001, 0.002]] * 3
    else:
        assert "12.0 images a second" in printed


def test_starts_are_measured_on_a_platform_for_each_engine(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the engine `process` there is another one with prepared environments."""
    started: list[tuple[str, int]] = []
    published: list[ApiClient] = []

    class FakeRobot:
        def __init__(self, url: str, **options: object) -> None:
            self.url = url

        async def __aenter__(self) -> FakeRobot:
            return self

        async def __aexit__(self, *error: object) -> None:
            return

    @asynccontextmanager
    async def platform(directory: Path, engine: str, warm: int) -> AsyncIterator[Ready]:
        started.append((engine, warm))
        yield Ready("master", f"http://{engine}-{warm}/")

    async def measure(robots: dict[str, FakeRobot], image: str, samples: int) -> start.Samples:
        assert image.startswith("rce/mapping:")
        return {name: [1.0] * samples for name in robots}

    monkeypatch.setattr(bench, "Robot", FakeRobot)
    monkeypatch.setattr(bench, "own_platform", platform)
    monkeypatch.setattr(start, "publish", published.append)
    monkeypatch.setattr(start, "measure", measure)
    assert run(["bench", "start", "--engines", "docker,process", "--samples", "2", "--json"]) == SUCCESS
    assert [engine for engine, _ in started] == ["docker", "process", "process"]
    assert [warm > 0 for _, warm in started] == [False, False, True]
    assert len(published) == 3
    assert json.loads(capsys.readouterr().out)["seconds"] == {
        name: [1.0] * 2 for name in ("docker", "process", start.WARM)
    }
