import fcntl
import os
from pathlib import Path

from endpoints.environment.dead_ports import MOST, lock_dead_ports


def is_locked(path: Path) -> bool:
    with path.open() as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def test_ports_without_a_reader_are_locked_until_the_result_is_closed(tmp_path: Path) -> None:
    dead, read = tmp_path / "fastdds_port7001_el", tmp_path / "fastdds_port7002_el"
    others = [tmp_path / "fastdds_0123456789abcdef_el", tmp_path / "fastdds_port7001"]
    for path in (dead, read, *others):
        path.touch()
    with read.open() as reader:
        fcntl.flock(reader, fcntl.LOCK_EX)
        with lock_dead_ports(tmp_path):
            assert is_locked(dead)
            assert not any(map(is_locked, others))
        assert not is_locked(dead)
        assert is_locked(read)
    assert not is_locked(read)


def test_files_of_another_kind_do_no_harm(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fastdds_port7001_el")  # to open it would wait for a writer
    (tmp_path / "fastdds_port7002_el").symlink_to("/etc/passwd")
    (tmp_path / "fastdds_port7003_el").mkdir()
    with lock_dead_ports(tmp_path):
        assert not is_locked(Path("/etc/passwd"))


def test_a_limited_number_of_ports_is_locked(tmp_path: Path) -> None:
    paths = [tmp_path / f"fastdds_port{number}_el" for number in range(MOST + 20)]
    for path in paths:
        path.touch()
    with lock_dead_ports(tmp_path):
        assert sum(map(is_locked, paths)) == MOST
