"""Clocks that jump for one process."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rce.bench.standby.clock import Clock, build

READ = "import time; print(time.time(), time.clock_gettime(time.CLOCK_MONOTONIC))"


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler: apt-get install gcc")
def test_time_of_day_jumps_and_the_monotonic_clock_does_not(tmp_path: Path) -> None:
    clock = Clock(build(tmp_path), tmp_path / "shift")
    assert clock.can_jump
    for shift in (3600.0, 0.0):
        clock.set(shift)
        done = subprocess.run([sys.executable, "-c", READ], env=os.environ | clock.environment, capture_output=True)
        day, monotonic = map(float, done.stdout.split())
        assert abs(day - time.time() - shift) < 600
        assert abs(monotonic - time.monotonic()) < 600


def test_without_a_compiler_no_clock_jumps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    clock = Clock(build(tmp_path), tmp_path / "shift")
    assert not clock.can_jump
    assert clock.environment == {}
