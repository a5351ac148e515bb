"""Logs of nodes."""

import asyncio
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


def test_one_who_follows_gets_each_whole_line_once(tmp_path: Path) -> None:
    log = NodeLog(tmp_path / "log")
    log.write(b"one\ntwo\nthr")
    lines, place = log.since("")
    assert lines == ["one", "two"]
    assert log.since(place) == ([], place)
    log.write(b"ee\nfour")
    lines, place = log.since(place)
    assert lines == ["three"]
    log.close()
    assert log.since(place)[0] == ["four"]


def test_one_who_follows_is_taken_over_the_change_of_files(tmp_path: Path) -> None:
    log = NodeLog(tmp_path / "log")
    place, seen = log.end, []
    for number in range(30):
        log.write(f"{number:<99999}\n".encode())
        while True:
            lines, place = log.since(place)
            if not lines:
                break
            seen += [line.strip() for line in lines if line.strip()]
    assert seen == [str(number) for number in range(30)]


def test_one_who_is_too_late_gets_what_is_kept(tmp_path: Path) -> None:
    log = NodeLog(tmp_path / "log")
    place = log.end
    for number in range(40):
        log.write(f"{number:<99999}\n".encode())
    lines, _ = log.since(place)
    assert lines[0].strip() == "20"


def test_a_place_in_an_earlier_life_is_before_all(tmp_path: Path) -> None:
    before = NodeLog(tmp_path / "log")
    before.write(b"before\n")
    again = NodeLog(tmp_path / "log")
    again.write(b"after\n")
    assert again.since(before.end)[0] == ["after"]
    assert again.since("nonsense")[0] == ["after"]


async def test_one_who_follows_waits_for_more(tmp_path: Path) -> None:
    log = NodeLog(tmp_path / "log")
    waiting = asyncio.ensure_future(log.more(log.end, 100))
    await asyncio.sleep(0)
    log.write(b"half")
    await asyncio.sleep(0)
    assert not waiting.done()
    log.write(b" a line\n")
    assert (await waiting)[0] == ["half a line"]
    assert (await log.more(log.end, 0))[0] == []
