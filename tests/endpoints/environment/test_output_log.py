"""Logs of output."""

import asyncio
import errno
import os
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from endpoints.environment.output_log import MAX_FILE_SIZE, MAX_LAST, MAX_LINE_LENGTH, OutputLog


def test_last_lines(tmp_path: Path) -> None:
    log = OutputLog(tmp_path / "log")
    log.write(b"one\ntw")
    log.write(b"o\n\xffthree")
    assert log.last_lines(2) == ["two", "\ufffdthree"]
    assert log.last_lines(0) == []


def test_size_is_bounded_and_newest_output_is_kept(tmp_path: Path) -> None:
    log = OutputLog(tmp_path / "log")
    for number in range(40):
        log.write(f"{number:<99999}\n".encode())
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 2 * (MAX_FILE_SIZE + 100_000)
    assert (tmp_path / "log").read_text().endswith(f"{39:<99999}\n")


@pytest.fixture
def full_disk() -> Iterator[Path]:
    """A file system that holds one MAX_FILE_SIZE and a half."""
    if os.geteuid():
        pytest.skip("mounting needs root")
    with tempfile.TemporaryDirectory() as name:
        mount = ["mount", "-t", "tmpfs", "-o", f"size={MAX_FILE_SIZE * 3 // 2},mode=700", "rce-test", name]
        if subprocess.run(mount, check=False, capture_output=True).returncode:
            pytest.skip("this machine cannot mount a tmpfs")
        try:
            yield Path(name)
        finally:
            subprocess.run(["umount", "-l", name], check=True)


def test_output_that_a_full_disk_refuses_is_counted(full_disk: Path) -> None:
    log = OutputLog(full_disk / "log")
    filler = full_disk / "filler"
    with suppress(OSError), filler.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(4096))
    assert log.last_lines(10) == []
    log.write(b"lost\n")
    log.write(b"also\n")
    filler.unlink()
    log.write(b"kept\n")
    assert log.last_lines(2) == ["[10 bytes of output are missing: no space left on device]", "kept"]


def test_log_that_cannot_begin_a_new_file_goes_on_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "no space")

    log = OutputLog(tmp_path / "log")
    log.write(b"x" * (MAX_FILE_SIZE - 4) + b"\nold\n")
    _, position = log.since("")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", fail)
        log.write(b"lost\n")
    assert log.last_lines(1) == ["old"]
    assert log.since(position)[0] == ["x" * MAX_LINE_LENGTH]
    log.write(b"new\n")
    assert log.last_lines(3) == ["", "[5 bytes of output are missing: no space left on device]", "new"]


def test_last_lines_include_older_file(tmp_path: Path) -> None:
    log = OutputLog(tmp_path / "log")
    log.write(b"x" * (MAX_FILE_SIZE - 4) + b"\nold")
    log.write(b"\nnew\n")
    assert log.last_lines(2) == ["old", "new"]


def test_last_lines_fit_into_one_control_message(tmp_path: Path) -> None:
    log = OutputLog(tmp_path / "log")
    log.write(b"x" * 99 + b"\n" + b"\xff" * 99 + b"\n" * 10_000)
    for _ in range(10_000):
        log.write(b"\xff" * 99 + b"\n")
    assert len("".join(log.last_lines(10_000)).encode()) <= 3 * MAX_LAST


def test_new_log_begins_new_file(tmp_path: Path) -> None:
    OutputLog(tmp_path / "log").write(b"before\n")
    again = OutputLog(tmp_path / "log")
    again.write(b"after\n")
    assert again.last_lines(10) == ["before", "after"]


def test_long_lines_are_cut(tmp_path: Path) -> None:
    log = OutputLog(tmp_path / "log")
    log.write(b"a" * 5000 + b"\n")
    assert [len(line) for line in log.last_lines(10)] == [MAX_LINE_LENGTH]


def test_reader_gets_each_complete_line_once(tmp_path: Path) -> None:
    log = OutputLog(tmp_path / "log")
    log.write(b"one\ntwo\nthr")
    lines, position = log.since("")
    assert lines == ["one", "two"]
    assert log.since(position) == ([], position)
    log.write(b"ee\nfour")
    lines, position = log.since(position)
    assert lines == ["three"]
    log.close()
    assert log.since(position)[0] == ["four"]


def test_reader_continues_in_new_file(tmp_path: Path) -> None:
    log = OutputLog(tmp_path / "log")
    position, seen = log.end, []
    for number in range(30):
        log.write(f"{number:<99999}\n".encode())
        while True:
            lines, position = log.since(position)
            if not lines:
                break
            seen += [line.strip() for line in lines if line.strip()]
    assert seen == [str(number) for number in range(30)]


def test_late_reader_gets_what_is_left(tmp_path: Path) -> None:
    log = OutputLog(tmp_path / "log")
    position = log.end
    for number in range(40):
        log.write(f"{number:<99999}\n".encode())
    lines, _ = log.since(position)
    assert lines[0].strip() == "20"


def test_position_of_earlier_log_counts_as_beginning(tmp_path: Path) -> None:
    before = OutputLog(tmp_path / "log")
    before.write(b"before\n")
    again = OutputLog(tmp_path / "log")
    again.write(b"after\n")
    assert again.since(before.end)[0] == ["after"]
    assert again.since("nonsense")[0] == ["after"]


async def test_reader_waits_for_complete_line(tmp_path: Path) -> None:
    log = OutputLog(tmp_path / "log")
    waiting = asyncio.ensure_future(log.wait_since(log.end, 100))
    await asyncio.sleep(0)
    log.write(b"half")
    await asyncio.sleep(0)
    assert not waiting.done()
    log.write(b" a line\n")
    assert (await waiting)[0] == ["half a line"]
    assert (await log.wait_since(log.end, 0))[0] == []
