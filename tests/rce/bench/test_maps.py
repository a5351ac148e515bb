"""Tests of the benchmarks of mappers with real processes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from rce.bench.large_recording import write

pytestmark = [pytest.mark.e2e, pytest.mark.ros]

TIMEOUT = 200.0


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("recording"), 1)[0]


def rce(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", "rce.cli", "bench", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=False)


def test_recording_is_uploaded_mapped_and_measured(recording: Path, tmp_path: Path) -> None:
    picture, out = tmp_path / "maps.svg", tmp_path / "out"
    words = ["--mappers", "graph", "--odometry", "worse,none", "--plot", str(picture), "--out", str(out), "--json"]
    done = rce("map", str(recording), *words)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    (seen,) = found["recordings"]
    assert (seen["scans"], seen["messages"], seen["size"]) == (60, 120, recording.stat().st_size)
    (served,) = found["served"]
    assert served["transmission"] > 0
    assert served["mapping"] > 0
    assert [each["odometry"] for each in found["mapped"]] == ["worse", "none"]
    for each in found["mapped"]:
        assert each["cpu"] > 0
        assert each["errors"]["near"][0] < 0.1
        assert (out / "small" / f"graph-{each['odometry']}" / "map.png").exists()
    assert "transmission" in picture.read_text()


def test_endless_run_is_measured(recording: Path, tmp_path: Path) -> None:
    picture = tmp_path / "endless.svg"
    done = rce("endless", str(recording), "--mappers", "graph", "--scans", "200", "--plot", str(picture), "--json")
    assert done.returncode == 0, done.stderr
    ((name, run),) = json.loads(done.stdout)["runs"].items()
    assert name == "small, graph"
    assert run["scans"][-1] == 200
    assert min(run["memory"]) > 0
    assert picture.exists()


def test_unknown_mapper_is_rejected(recording: Path) -> None:
    done = rce("map", str(recording), "--mappers", "graph,guess")
    assert done.returncode == 1
    assert "no mapper guess" in done.stderr
