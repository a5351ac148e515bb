"""Control groups: on a tree of files that stands for version 2, and on those of this machine."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from uuid import uuid4

import pytest

from containers.process.cgroups import ControlGroups
from rce.protocol.messages import ContainerData

MB = 1024 * 1024
RUN = "1" * 32
HOG = "import sys; sys.stdin.readline(); x = [bytearray(1 << 20) for _ in range(200)]"


# --- version 2, as files ----------------------------------------------------------------------------------------------


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Hierarchy of which `user` is delegated; the kernel would make the files of the engine's group `rce` in it."""
    for place, controllers in (
        ("cgroup", "cpu memory pids"),
        ("cgroup/user", "memory pids"),
        ("cgroup/user/rce", "memory pids"),
        ("cgroup/user/app", "memory"),
    ):
        (tmp_path / place).mkdir()
        (tmp_path / place / "cgroup.controllers").write_text(controllers)
        (tmp_path / place / "cgroup.subtree_control").write_text("")
    (tmp_path / "cgroup/cgroup.subtree_control").unlink()  # the root belongs to others
    (tmp_path / "own").write_text("0::/user/app\n")
    return tmp_path


@pytest.fixture
def unified(tree: Path) -> ControlGroups:
    made = ControlGroups("rce", tree / "cgroup", tree / "own")
    made.open([])
    return made


def test_topmost_group_that_may_be_made_is_used(tree: Path, unified: ControlGroups) -> None:
    assert unified.enforced == {"memory", "pids"}
    assert (tree / "cgroup/user/cgroup.subtree_control").read_text() == "+memory +pids"
    unified.create(RUN, ContainerData(memory=100 * MB, pids=50, cpu=1))
    run = tree / "cgroup/user/rce" / RUN
    assert (run / "memory.max").read_text() == str(100 * MB)
    assert (run / "pids.max").read_text() == "50"
    assert not (run / "cpu.max").exists(), "its controller is not delegated"


def test_cores_are_a_share_of_time(tree: Path) -> None:
    for place in ("user", "user/rce"):
        (tree / "cgroup" / place / "cgroup.controllers").write_text("cpu")
    groups = ControlGroups("rce", tree / "cgroup", tree / "own")
    groups.open([])
    groups.create(RUN, ContainerData(cpu=1.5))
    assert (tree / "cgroup/user/rce" / RUN / "cpu.max").read_text() == "150000 100000"


def test_processes_are_counted_that_exceeded_the_limit(tree: Path, unified: ControlGroups) -> None:
    unified.create(RUN, ContainerData())
    assert unified.killed(RUN) == 0
    (tree / "cgroup/user/rce" / RUN / "memory.events").write_text("low 0\nmax 12\noom 2\noom_kill 1\n")
    assert unified.killed(RUN) == 1


def test_without_control_groups_nothing_is_enforced(tmp_path: Path) -> None:
    groups = ControlGroups("rce", tmp_path / "none", tmp_path / "own")
    groups.open([])
    groups.create(RUN, ContainerData(memory=1))
    groups.add(RUN, os.getpid())
    groups.remove(RUN)
    groups.close()
    assert (groups.enforced, groups.killed(RUN)) == (frozenset(), 0)


# --- those of this machine --------------------------------------------------------------------------------------------


@pytest.fixture
def groups() -> Iterator[ControlGroups]:
    made = ControlGroups(f"rce-test-{uuid4().hex}")
    made.open([])
    if "memory" not in made.enforced:
        pytest.skip("this user cannot make control groups")
    yield made
    made.close()
    assert not any(group.exists() for group in made._groups.values())


def begin(groups: ControlGroups, program: str) -> subprocess.Popen[bytes]:
    """Start a Python program in the group of the run; it waits for a line first."""
    process = subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE)
    groups.add(RUN, process.pid)
    return process


def test_process_beyond_the_memory_limit_is_killed(groups: ControlGroups) -> None:
    groups.create(RUN, ContainerData(memory=64 * MB, cpu=0.5, pids=20))
    process = begin(groups, HOG)
    process.communicate(b"\n")
    assert process.returncode == -9
    assert groups.killed(RUN) >= 1
    groups.remove(RUN)


def test_everything_in_a_group_is_killed_with_it(groups: ControlGroups) -> None:
    groups.create(RUN, ContainerData())
    process = begin(groups, "import sys; sys.stdin.readline(); sys.stdin.readline()")
    groups.remove(RUN)
    assert process.wait(60) == -9


def test_process_that_has_ended_is_not_moved(groups: ControlGroups) -> None:
    groups.create(RUN, ContainerData())
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    groups.add(RUN, process.pid)
    groups.remove(RUN)


def test_groups_of_runs_that_have_ended_are_removed(groups: ControlGroups) -> None:
    for run in (RUN, "2" * 32):
        groups.create(run, ContainerData())
    later = ControlGroups(groups._name)
    later.open([RUN])
    left = {path.name for group in later._groups.values() for path in group.iterdir() if path.is_dir()}
    assert left == {RUN}
    groups.remove(RUN)
