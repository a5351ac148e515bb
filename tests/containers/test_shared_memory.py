import fcntl
import os
from pathlib import Path

from containers import shared_memory


def segment(directory: Path, number: int, age: float) -> Path:
    path = directory / f"fastdds_{number:016x}"
    lock = path.with_name(path.name + "_el")
    for file in (path, lock):
        file.write_bytes(b"x")
        then = file.stat().st_mtime - age
        os.utime(file, (then, then))
    return path


def test_only_segments_of_the_dead_are_removed(tmp_path: Path) -> None:
    dead, living, young = segment(tmp_path, 1, 10), segment(tmp_path, 2, 10), segment(tmp_path, 3, 0)
    other = tmp_path / "somebody_else_s_el"
    other.touch()
    with living.with_name(living.name + "_el").open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        shared_memory.clean(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        *(living.name, living.name + "_el"),
        *(young.name, young.name + "_el"),
        other.name,
    }
    assert not dead.exists()


def test_ports_of_one_domain(tmp_path: Path) -> None:
    ours = ["fastdds_port8161", "sem.fastdds_port8161_mutex", "fastdds_port8161_el", "fastdds_port7003"]
    others = ["fastdds_port7411", "fastdds_port8400", "fastdds_port7000", "fastdds_portal"]
    for name in ours + others:
        (tmp_path / name).touch()
    shared_memory.clean_ports(3, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == set(others)
