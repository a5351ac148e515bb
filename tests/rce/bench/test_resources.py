"""Trends of memory, descriptors and tasks, and the processes that are sampled."""

from __future__ import annotations

import mmap
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import pytest

pytest.importorskip("psutil", reason="needs the extra `bench`")

from rce.api.http import EntryClient
from rce.bench.resources import Observer, Series, own_memory, trend

METRICS = b"# HELP rce_tasks Tasks\nrce_tasks 7.0\nrce_tasks_other 9\n"


class FakeMetrics:
    """Metrics of any process, with 7 tasks."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def json(self, method: str, path: str) -> bytes:
        self.asked.append(path)
        return METRICS


def series(values: list[float]) -> Series:
    made = Series()
    for number, value in enumerate(values):
        made.add(10.0 * number, memory=value)
    return made


def test_growth_is_that_after_the_warm_up() -> None:
    found = trend(series([50.0, 90.0, 99.0, *[100.0] * 9]), "memory")
    assert found.flat
    assert found.growth == pytest.approx(0.0)
    assert found.first == found.last == pytest.approx(100.0)


def test_growth_of_more_than_two_percent_is_not_flat() -> None:
    values = [100.0 + number for number in range(12)]
    found = trend(series(values), "memory")
    assert not found.flat
    assert found.first == pytest.approx(104.0)
    assert found.last == pytest.approx(111.0)
    assert found.growth == pytest.approx(7 / 107.5)
    assert found.hourly == pytest.approx(360.0)


def test_shrinking_is_flat() -> None:
    assert trend(series([100.0 - number for number in range(12)]), "memory").flat


def test_one_sample_has_no_trend() -> None:
    assert trend(series([5.0]), "memory") == (5.0, 5.0, 0.0, 0.0)


@pytest.fixture
def program(tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Process of this one with the command line of a Master."""
    (tmp_path / "master").mkdir()
    (tmp_path / "master" / "__init__.py").touch()  # else that of this checkout is found
    (tmp_path / "master" / "__main__.py").write_text("print(flush=True)\ninput()")
    pipe = subprocess.PIPE
    started = subprocess.Popen([sys.executable, "-m", "master"], cwd=tmp_path, stdin=pipe, stdout=pipe)
    assert started.stdout is not None
    started.stdout.readline()  # before, it has neither memory nor a command line for an instant
    yield started
    started.kill()
    started.wait()


def test_processes_are_sampled_by_name(program: subprocess.Popen[bytes], tmp_path: Path) -> None:
    (tmp_path / "master.db").write_bytes(b"x" * 100)
    metrics = FakeMetrics()
    observer = Observer(tmp_path, cast(EntryClient, metrics), "ann/brain")
    observer.sample(1.0)
    observer.sample(2.0)
    found = observer.series["Master"]
    assert found.times == [1.0, 2.0]
    assert found.figures.keys() == {"memory", "descriptors", "threads", "tasks"}
    assert found.figures["tasks"] == [7.0, 7.0]
    assert min(found.figures["memory"]) > 1_000_000
    assert observer.series["data"].figures["database"] == [100, 100]
    assert observer.restarts == []
    assert set(metrics.asked) == {"metrics"}


def test_directories_may_be_removed_while_files_are_counted(tmp_path: Path) -> None:
    """Sample while directories come and go, as those of environments do."""
    observer = Observer(tmp_path, cast(EntryClient, FakeMetrics()), "ann/brain")
    over = threading.Event()

    def come_and_go() -> None:
        while not over.is_set():
            (tmp_path / "environments" / "brain" / "logs").mkdir(parents=True)
            shutil.rmtree(tmp_path / "environments")

    coming = threading.Thread(target=come_and_go)
    coming.start()
    try:
        for number in range(300):
            observer.sample(float(number))
    finally:
        over.set()
        coming.join()
    assert len(observer.series["data"].times) == 300


def test_pages_of_files_are_not_a_process_own_memory(tmp_path: Path) -> None:
    size = 32_000_000
    file = tmp_path / "library"
    file.write_bytes(bytes(size))
    before = own_memory(os.getpid())
    with file.open("rb") as opened, mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
        assert sum(mapped[:: mmap.PAGESIZE]) == 0
        assert own_memory(os.getpid()) - before < size / 2
    with mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS) as allocated:
        allocated[:: mmap.PAGESIZE] = b"x" * len(range(0, size, mmap.PAGESIZE))
        assert own_memory(os.getpid()) - before > size / 2
