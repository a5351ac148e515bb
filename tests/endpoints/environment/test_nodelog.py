"""Logs of nodes."""

from pathlib import Path

from endpoints.environment.nodelog import LONGEST_LINE, MOST, NodeLog


def test_last_lines(tmp_path: Path) -> None:
    log = NodeLog(tmp_path / "log")
    log.write(b"one\ntw")
    log.write(b"o\n\xffthree")
    assert log.last_lines(2) == ["two", "\ufffdthree"]
    assert log.last_lines(0) == []


def test_size_is_bounded_and_the_newest_is_kept(tmp_path: Path) -> None:
    log = NodeLog(tmp_path / "log")
    for number in range(40):
        log.write(f"{number:<99999}\n".encode())
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 2 * (MOST + 100_000)
    assert (tmp_path / "log").read_text().endswith(f"{39:<99999}\n")


def test_lines_reach_back_into_the_older_file(tmp_path: Path) -> None:
    log = NodeLog(tmp_path / "log")
    log.write(b"x" * (MOST - 4) + b"\nold")
    log.write(b"\nnew\n")
    assert log.last_lines(2) == ["old", "new"]


def test_a_later_life_has_a_new_file(tmp_path: Path) -> None:
    NodeLog(tmp_path / "log").write(b"before\n")
    again = NodeLog(tmp_path / "log")
    again.write(b"after\n")
    assert again.last_lines(10) == ["before", "after"]


def test_long_lines_are_cut(tmp_path: Path) -> None:
    log = NodeLog(tmp_path / "log")
    log.write(b"a" * 5000 + b"\n")
    assert [len(line) for line in log.last_lines(10)] == [LONGEST_LINE]
