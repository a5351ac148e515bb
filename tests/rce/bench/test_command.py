"""Tests of `rce bench` with real processes."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rce.bench.payloads import IMAGE, sizes

pytest.importorskip("rclpy", reason="needs the extra `ros`")

pytestmark = [pytest.mark.e2e, pytest.mark.ros]

TIMEOUT = 100.0
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
TOPICS = {"n2n string", "n2n bytes", "r2c json", "r2c blob", "r2c forwarder"}
IMAGES = {"n2n image", "r2c image_forwarder", "r2c image_json"}
SERVICES = {"n2n service", "r2c service json", "r2c service forwarder"}
FLOORS = {"tcp", "autobahn"}


def rce(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", "rce.cli", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=False)


def test_round_trips_are_measured(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="needs the extra `bench`")
    picture = tmp_path / "rtt.svg"
    done = rce("bench", "rtt", "--sizes", "2", "--samples", "2", "--json", "--plot", str(picture))
    assert done.returncode == 0, done.stderr
    series = {each["name"]: each for each in json.loads(done.stdout)["series"]}
    assert set(series) == TOPICS | IMAGES | SERVICES | FLOORS
    every = [str(size) for size in sizes(2)]
    for name, each in series.items():
        expected = [str(IMAGE)] if name in IMAGES else every + [str(IMAGE)] * (name in FLOORS)
        assert list(each["seconds"]) == expected, name
        assert all(len(taken) == 2 and min(taken) > 0 for taken in each["seconds"].values())
        assert not each["beside"] or each["beside"] in series
    assert "r2c forwarder" in picture.read_text()


def test_commands_are_measured_beside_images() -> None:
    done = rce("bench", "overtake", "--samples", "5", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["overtake"]
    for taken in (found["alone"], found["beside"]):
        assert len(taken) == 5
        assert all(0 < there < back < math.inf for there, back in taken)
    assert found["rate"] > 0


def test_unknown_route_is_rejected() -> None:
    done = rce("bench", "rtt", "--routes", "n2n,c2x")
    assert done.returncode == 1
    assert "c2x" in done.stderr


def test_round_trips_between_two_environments_are_measured() -> None:
    done = rce("bench", "rtt", "--routes", "c2c,group", "--sizes", "2", "--samples", "1", "--json")
    assert done.returncode == 0, done.stderr
    series = {each["name"]: each for each in json.loads(done.stdout)["series"]}
    assert set(series) == {f"{route} {kind}" for route in ("c2c", "group") for kind in ("string", "bytes", "service")}
    assert all(min(taken) > 0 for each in series.values() for taken in each["seconds"].values())
    assert series["group service"]["transport"] == "service"


def test_route_between_machines_requires_features() -> None:
    done = rce("bench", "rtt", "--routes", "c2c2", "--quick")
    assert done.returncode == 1
    assert "--features" in done.stderr


def test_starts_are_measured() -> None:
    done = rce("bench", "start", "--engines", "process", "--samples", "1", "--json")
    assert done.returncode == 0, done.stderr
    (taken,) = json.loads(done.stdout)["seconds"]["process"]
    assert 0 < taken < math.inf


def test_dashboard_is_measured_with_a_crowd() -> None:
    pytest.importorskip("playwright", reason="needs the extra `bench`")
    pytest.importorskip("psutil", reason="needs the extra `bench`")
    if not any(map(shutil.which, BROWSERS)):
        pytest.skip("needs Chromium")
    done = rce("bench", "dashboard", "--robots", "20", "--seconds", "1", "--samples", "1", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["dashboard"]
    assert (found["robots"], found["interfaces"]) == (20, 200)
    assert set(found["lists"]) == {"env list", "robot list"}
    figures = [found[name] for name in ("browser", "master", "quiet")]
    taken = [*found["loads"], *(each for one in found["lists"].values() for kind in one.values() for each in kind)]
    assert len(taken) == 5
    assert min(taken) > 0
    assert max(*taken, *figures) < math.inf


def test_crowd_without_robots_is_rejected() -> None:
    pytest.importorskip("playwright", reason="needs the extra `bench`")
    done = rce("bench", "dashboard", "--robots", "0")
    assert done.returncode == 1
    assert "--robots" in done.stderr


def test_unknown_engine_is_rejected() -> None:
    done = rce("bench", "start", "--engines", "cloud")
    assert done.returncode == 1
    assert "cloud" in done.stderr
