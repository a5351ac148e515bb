"""Command lines of the platform's processes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from rce.bench.chaos.platform import PROGRAMS, Platform
from rce.process.ready import Ready


@pytest.fixture
def platform(tmp_path: Path) -> Iterator[Platform]:
    platform = Platform(tmp_path, {}, tmp_path / "log")
    platform.processes["master"].ready = Ready("master", "http://127.0.0.1:1/", "tcp:127.0.0.1:2")
    yield platform
    platform._out.close()


def test_each_process_has_a_directory_of_its_own(platform: Platform) -> None:
    directories = {
        word
        for process in platform.processes.values()
        for word in process._arguments()
        if word.startswith("--data-dir=")
    }
    assert directories == {f"--data-dir={platform.directory / name}" for name in PROGRAMS}


def test_restarted_process_listens_on_the_same_ports(platform: Platform) -> None:
    endpoint = platform.processes["robot-2"]
    assert "--ws-port=0" in endpoint._arguments()
    endpoint.ready = Ready("robot-2", "ws://127.0.0.1:7/")
    assert "--ws-port=7" in endpoint._arguments()
    assert {"--http=tcp:1:interface=127.0.0.1", "--control=tcp:2:interface=127.0.0.1"} < set(
        platform.processes["master"]._arguments()
    )


def test_master_admits_each_process_by_a_token_of_its_own(platform: Platform) -> None:
    allowed = platform.processes["master"]._environment["RCE_TOKENS"].split(",")
    assert [each.rsplit(":", 1)[0] for each in allowed] == [
        "robot:robot-1",
        "robot:robot-2",
        "container:container",
        "service:map-service",
    ]
    assert len({each.rsplit(":", 1)[1] for each in allowed}) == 4
