"""The first process of a container, seen from outside: here of a PID namespace."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from containers.endpoint import OPEN_FILES
from containers.kubernetes import process
from containers.kubernetes.process import first_process, is_alive, used
from rce.errors import StartFailed

CONTAINER = "c0ffee"


@pytest.fixture
def proc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory in place of /proc."""
    monkeypatch.setattr(process, "PROC", tmp_path)
    monkeypatch.setattr(process, "SEARCH_SECONDS", 0.0)
    return tmp_path


def add(proc: Path, number: int, group: str, own: str) -> None:
    (proc / str(number)).mkdir()
    (proc / str(number) / "cgroup").write_text(f"0::/kubepods/{group}\n")
    (proc / str(number) / "status").write_text(f"Name:\tx\nNSpid:\t{number}\t{own}\n")


def test_first_process_of_a_container_is_found(proc: Path) -> None:
    add(proc, 7, f"cri-containerd-{CONTAINER}.scope", "12")
    add(proc, 8, f"cri-containerd-{CONTAINER}.scope", "1")
    add(proc, 9, "cri-containerd-other.scope", "1")
    (proc / "self").mkdir()
    assert first_process(CONTAINER) == 8
    assert is_alive(8, CONTAINER)
    assert not is_alive(9, CONTAINER)
    assert not is_alive(10, CONTAINER)


def test_container_that_has_ended_has_no_process(proc: Path) -> None:
    with pytest.raises(StartFailed, match="no process"):
        first_process(CONTAINER)


def test_usage_excludes_inactive_files(proc: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add(proc, 8, CONTAINER, "1")
    monkeypatch.setattr(process, "CGROUPS", proc)
    group = proc / "kubepods" / CONTAINER
    group.mkdir(parents=True)
    (proc / "cgroup.controllers").touch()
    (group / "memory.current").write_text("1000\n")
    (group / "memory.stat").write_text("anon 600\ninactive_file 300\n")
    (group / "cpu.stat").write_text("usage_usec 2500000\n")
    found = used(8)
    assert found is not None
    assert (found.seconds, found.memory) == (2.5, 700)
    assert used(9) is None


@pytest.fixture
def child() -> Iterator[int]:
    user = os.getuid()
    if user != 0:
        pytest.skip("processes of other users need root: run the tests as root")
    running = subprocess.Popen(["sleep", "60"], user=12345, group=12345, extra_groups=[])
    yield running.pid
    running.kill()
    running.wait()


def test_files_are_limited_as_the_user_of_the_process(child: int) -> None:
    until = time.monotonic() + 10
    while b"sleep" not in Path(f"/proc/{child}/cmdline").read_bytes():
        assert time.monotonic() < until
    process._in_child(lambda: process._limit_files(child, 12345), "not limited")
    lines = Path(f"/proc/{child}/limits").read_text().splitlines()
    (files,) = [line.split()[3:5] for line in lines if line.startswith("Max open files")]
    assert files == [str(OPEN_FILES)] * 2


def test_failure_in_a_child_is_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    def fail() -> None:
        raise OSError("reason")

    with pytest.raises(OSError, match="what failed"):
        process._in_child(fail, "what failed")
    assert "reason" in capfd.readouterr().err
