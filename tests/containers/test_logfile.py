from pathlib import Path

import pytest

from containers import logfile


def test_last_lines_of_a_short_log(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_bytes(b"one\ntwo\xff\nthree")
    assert logfile.last_lines(log, 2) == ["two\N{REPLACEMENT CHARACTER}", "three"]
    assert logfile.last_lines(tmp_path / "none", 2) == []


def test_long_lines_are_cut(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_text("x" * 10_000 + "\nend\n")
    assert [len(line) for line in logfile.last_lines(log, 5)] == [logfile.LONGEST_LINE, 3]


def test_log_is_bounded_and_keeps_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logfile, "MAX_SIZE", 1000)
    log = tmp_path / "log"
    with log.open("ab", buffering=0) as writer:
        for number in range(1000):
            writer.write(b"line %d\n" % number)
            if number % 10 == 0:
                logfile.trim(log)
                assert log.stat().st_size + logfile.older(log).stat().st_size <= 2000 if number > 200 else True
        assert logfile.last_lines(log, 60) == [f"line {number}" for number in range(940, 1000)]


def test_missing_log_has_no_lines(tmp_path: Path) -> None:
    logfile.trim(tmp_path / "none")
