import fcntl
import os
from pathlib import Path

import pytest

from containers.process import shared_memory


def segment(directory: Path, number: int, age: float) -> Path:
    path = directory / f"fastdds_{number:016x}"
    lock = path.with_name(path.name + "_el")
    for file in (path, lock):
        file.write_bytes(b"x")
        then = file.stat().st_mtime - age
        os.utime(file, (then, then))
    return path


def lock_of(segment: Path) -> Path:
    return segment.with_name(segment.name + "_el")


def test_only_segments_of_dead_participants_are_removed(tmp_path: Path) -> None:
    dead, living, beginning, died_young = (segment(tmp_path, n, 10 if n < 3 else 0) for n in range(1, 5))
    other = tmp_path / "somebody_else_s_el"
    other.touch()
    with lock_of(living).open() as held, lock_of(beginning).open() as later:
        fcntl.flock(held, fcntl.LOCK_EX)

        def wait(seconds: float) -> None:
            fcntl.flock(later, fcntl.LOCK_EX)
            then = lock_of(died_young).stat().st_mtime - seconds
            os.utime(lock_of(died_young), (then, then))

        shared_memory.clean(tmp_path, wait)
    assert {path.name for path in tmp_path.iterdir()} == {
        *(living.name, lock_of(living).name),
        *(beginning.name, lock_of(beginning).name),
        other.name,
    }
    assert not dead.exists()


def test_concurrent_cleaning_is_safe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(3):
        segment(tmp_path, number, 10)
    is_free = shared_memory._is_free

    def removed_concurrently(lock: Path) -> bool:
        lock.unlink()
        return is_free(lock)

    monkeypatch.setattr(shared_memory, "_is_free", removed_concurrently)
    shared_memory.clean(tmp_path)
    assert not list(tmp_path.glob("*_el"))


def test_ports_of_one_domain_are_removed(tmp_path: Path) -> None:
    own = ["fastdds_port8161", "sem.fastdds_port8161_mutex", "fastdds_port8161_el"]
    others = ["fastdds_port7411", "fastdds_port8400", "fastdds_port7003", "fastdds_port7003_el", "fastdds_portal"]
    for name in own + others:
        (tmp_path / name).touch()
    shared_memory.clean_ports(3, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == set(others)


def test_lock_of_a_starting_participant_is_not_touched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    segment(tmp_path, 1, age=0)
    tried: list[Path] = []
    monkeypatch.setattr(shared_memory, "_is_free", tried.append)
    shared_memory.clean(tmp_path, wait=lambda seconds: None)
    assert not tried
