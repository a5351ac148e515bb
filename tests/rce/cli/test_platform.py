"""Platforms that a command starts for itself, with a stand-in for the platform."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import IO

import pytest

from rce.cli.arguments import DEV_USER
from rce.cli.contexts import Access
from rce.cli.platform import LOG_LINES, own_platform, platform, programs_log
from rce.errors import InternalError, NotFound, StartFailed
from rce.process import up
from rce.process.ready import Ready

READY = Ready("up", "http://127.0.0.1:4711/")


class Played:
    """Stand-in for `up.run`: starts at once, or fails with `failure`."""

    def __init__(self) -> None:
        self.settings: list[up.Settings] = []
        self.ended = False
        self.failure: Exception | None = None

    async def run(self, settings: up.Settings, started: Callable[[Ready], Awaitable[None]], log: IO[str]) -> None:
        self.settings.append(settings)
        print("the log", file=log)
        if self.failure is not None:
            raise self.failure
        try:
            await started(READY)
        finally:
            self.ended = True


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> Played:
    played = Played()
    monkeypatch.setattr(up, "run", played.run)
    return played


async def test_own_platform_runs_until_the_context_ends(played: Played, tmp_path: Path) -> None:
    async with own_platform(tmp_path, "docker") as entry:
        assert entry == READY
        assert not played.ended
    assert played.ended
    (settings,) = played.settings
    assert (settings.data_dir, settings.http_port, settings.dev, settings.engine) == (tmp_path, 0, True, "docker")


async def test_own_platform_ends_with_an_error_of_the_caller(played: Played, tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        async with own_platform(tmp_path, "process"):
            raise NotFound("no scans")
    assert played.ended


async def test_platform_that_does_not_start_prints_its_log(
    played: Played, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    played.failure = StartFailed("the Master did not start")
    with pytest.raises(StartFailed, match="the Master did not start"):
        async with own_platform(tmp_path, "process"):
            raise AssertionError("it has started")
    assert capsys.readouterr().err == "the log\n"


async def test_without_url_a_platform_of_ones_own_is_used(played: Played) -> None:
    async with platform(argparse.Namespace(url="", engine="process")) as access:
        assert access == Access(READY.url, DEV_USER, DEV_USER, None)
        directory = played.settings[0].data_dir
        assert await asyncio.to_thread(directory.is_dir)
    assert not await asyncio.to_thread(directory.exists)


async def test_platform_of_the_url_is_not_started(played: Played, no_context: Path) -> None:
    args = argparse.Namespace(url="http://a/", user="ann", password="pw", engine="process")
    async with platform(args) as access:
        assert access == Access("http://a/", "ann", "pw", None)
    assert not played.settings


def fail_after(lines: int, error: Exception) -> None:
    """Raise an error after so many lines of log."""
    with programs_log() as log:
        log.writelines(f"line {number}\n" for number in range(lines))
        raise error


@pytest.mark.parametrize("error", [StartFailed("a program ended"), InternalError("a bug")])
def test_last_lines_of_the_log_are_printed_on_failure(error: Exception, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(type(error)):
        fail_after(LOG_LINES + 5, error)
    lines = capsys.readouterr().err.splitlines()
    assert (len(lines), lines[0], lines[-1]) == (LOG_LINES, "line 5", f"line {LOG_LINES + 4}")


def start_without_docker() -> None:
    with programs_log() as log:
        log.write('{"level": "error", "message": "no Docker answers"}\n')
        log.write('{"level": "info", "message": "stopping"}\nTraceback\n')
        raise StartFailed("container did not start")


def test_error_has_the_reason_from_the_log() -> None:
    with pytest.raises(StartFailed, match=r"^container did not start: no Docker answers$"):
        start_without_docker()


def test_log_is_not_printed_for_other_errors(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(NotFound):
        fail_after(1, NotFound("no scans"))
    assert capsys.readouterr().err == ""
