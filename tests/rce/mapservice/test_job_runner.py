"""Processes of jobs, with small programs in place of `job_program`."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path
from typing import Any

import pytest

from rce.api.map_jobs import MapOptions
from rce.errors import InternalError, InvalidRequest, TimedOut
from rce.mapservice import job_runner
from rce.mapservice.job_program import Platform, Report, Task
from rce.mapservice.job_runner import JobRunner
from tests.support.fake_platform import KEY, FakePlatform

TASK = Task("a.log", MapOptions(resolution=0.1), "out", "map_x_2", ["map_x_1"], Platform("http://e/", "ann", "rce_key"))
CLEAN = 'print(\'{"stage": "finishing", "scans": 3, "clean": true}\', flush=True)\n'
STARTED = 'print(\'{"stage": "mapping", "scans": 1}\', flush=True)\n'
FOREVER = "import signal\nwhile True: signal.pause()\n"
DEAF = "import signal\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\n" + STARTED + FOREVER
OBEDIENT = f"""
import signal
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
{STARTED}
signal.sigwait([signal.SIGTERM])
{CLEAN}
"""


class Runner(JobRunner):
    """Runner of a Python program that records what it cleans up itself."""

    def __init__(self, program: str, max_time: float = 60.0) -> None:
        super().__init__(max_time, (sys.executable, "-S", "-E", "-c", program))
        self.cleaned: list[Task] = []

    async def clean(self, task: Task) -> None:
        self.cleaned.append(task)


async def build(runner: Runner, directory: Path) -> list[Report]:
    """Build a map and return the reports."""
    reports: list[Report] = []
    await runner.build(TASK, directory / "log.txt", reports.append)
    return reports


async def until_started(runner: Runner, directory: Path) -> asyncio.Task[None]:
    """Start a job and wait for its first report."""
    started = asyncio.Event()
    job = asyncio.create_task(runner.build(TASK, directory / "log.txt", lambda _: started.set()))
    await started.wait()
    return job


async def test_process_gets_the_task_as_json(tmp_path: Path) -> None:
    program = f"import sys\nopen({str(tmp_path / 'task')!r}, 'w').write(sys.stdin.read())\n{CLEAN}"
    await build(Runner(program), tmp_path)
    task = json.loads((tmp_path / "task").read_text())
    assert (task["recording"], task["options"]["resolution"], task["platform"]["key"]) == ("a.log", 0.1, "rce_key")


async def test_reports_are_forwarded_and_other_output_is_ignored(tmp_path: Path) -> None:
    program = "import sys\nprint('a library says hello')\nprint('to the log', file=sys.stderr)\n"
    runner = Runner(program + STARTED + CLEAN)
    assert await build(runner, tmp_path) == [Report("mapping", 1), Report("finishing", 3, clean=True)]
    assert (tmp_path / "log.txt").read_text() == "to the log\n"
    assert runner.cleaned == []


async def test_log_of_an_earlier_attempt_is_kept(tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text("first\n")
    await build(Runner(f"import sys\nprint('second', file=sys.stderr)\n{CLEAN}"), tmp_path)
    assert (tmp_path / "log.txt").read_text() == "first\nsecond\n"


async def test_process_that_ends_before_it_gets_its_task_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = asyncio.create_subprocess_exec

    async def start_late(*words: str, **options: Any) -> Any:
        process = await start(*words, **options)
        await process.wait()
        assert process.stdin is not None
        process.stdin.close()  # as the loop does when it notices that the other end is closed
        await asyncio.sleep(0)
        return process

    monkeypatch.setattr(asyncio, "create_subprocess_exec", start_late)
    with pytest.raises(InternalError, match="status 3"):
        await build(Runner("raise SystemExit(3)"), tmp_path)


async def test_error_of_the_process_is_raised_as_its_class(tmp_path: Path) -> None:
    error = {"code": "invalid_request", "message": "no scans", "field": "uploads"}
    runner = Runner(f"print({json.dumps(json.dumps({'error': error, 'clean': True}))})")
    with pytest.raises(InvalidRequest, match="no scans") as failed:
        await build(runner, tmp_path)
    assert failed.value.field == "uploads"
    assert runner.cleaned == []


@pytest.mark.parametrize(("program", "status"), [("", 0), (STARTED + "raise SystemExit(3)", 3)], ids=["silent", "dead"])
async def test_process_that_ends_early_fails_the_job_and_is_cleaned_up_after(
    tmp_path: Path, program: str, status: int
) -> None:
    runner = Runner(program)
    with pytest.raises(InternalError, match=f"status {status}"):
        await build(runner, tmp_path)
    assert runner.cleaned == [TASK]


async def test_job_that_takes_too_long_is_stopped(tmp_path: Path) -> None:
    runner = Runner(FOREVER, max_time=0.01)
    with pytest.raises(TimedOut, match=r"more than 0\.01 s"):
        await build(runner, tmp_path)
    assert runner.cleaned == [TASK]


async def test_cancelled_process_cleans_up_itself(tmp_path: Path) -> None:
    runner = Runner(OBEDIENT)
    job = await until_started(runner, tmp_path)
    job.cancel()
    with pytest.raises(asyncio.CancelledError):
        await job
    assert runner.cleaned == []


async def test_process_that_ignores_its_cancellation_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job_runner, "STOP_TIMEOUT", 0.01)
    runner = Runner(DEAF)
    job = await until_started(runner, tmp_path)
    job.cancel()
    with pytest.raises(asyncio.CancelledError):
        await job
    assert runner.cleaned == [TASK]


async def test_inspection_returns_the_number_of_scans() -> None:
    assert await Runner('print(\'{"total": 12, "clean": true}\')').inspect(TASK) == 12
    assert await Runner(CLEAN).inspect(TASK) is None


async def test_inspection_that_takes_too_long_refuses_the_recording(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job_runner, "INSPECT_TIMEOUT", 0.01)
    with pytest.raises(InvalidRequest, match="could not be opened") as refused:
        await Runner(FOREVER).inspect(TASK)
    assert refused.value.field == "uploads"


async def test_environments_of_all_attempts_are_removed() -> None:
    async with FakePlatform() as platform:
        async with platform.robot() as robot:
            for name in ("map_x_0", "map_x_2", "other"):
                await robot.create_environment(name)
        user = Platform(platform.url, "testUser", KEY)
        await JobRunner(60.0).clean(Task("a.log", MapOptions(), "", "map_x_2", ["map_x_0", "map_x_1"], user))
        assert {name for kind, name in platform.resources if kind == "environment"} == {"other"}


async def test_unreachable_platform_does_not_fail_the_clean_up() -> None:
    async with FakePlatform() as platform:
        url = platform.url
    await JobRunner(60.0).clean(Task("a.log", MapOptions(), "", "map_x_1", [], Platform(url, "testUser", KEY)))


async def test_process_that_looks_at_a_recording_for_too_long_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    """It cannot be interrupted while it is deep in a file, and it has nothing to remove."""
    monkeypatch.setattr(job_runner, "INSPECT_TIMEOUT", 0.1)
    runner = Runner(DEAF)
    async with asyncio.timeout(job_runner.STOP_TIMEOUT / 2):
        with pytest.raises(InvalidRequest, match="could not be opened within"):
            await runner.inspect(Task("a.log.gz", MapOptions()))
