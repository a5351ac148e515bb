"""Child processes that inspect and map recordings (`rce.mapservice.job_program`)."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
from twisted.logger import Logger

from rce.client import Robot
from rce.errors import MALFORMED, InternalError, InvalidRequest, RceError, TimedOut
from rce.mapservice.job_program import Report, Task, remove_environments, trust_only

PROGRAM = (sys.executable, "-P", "-m", "rce.mapservice.job_program")
INSPECT_TIMEOUT = 60.0  # seconds
STOP_TIMEOUT = 20.0  # from SIGTERM to SIGKILL
CLEANUP_TIMEOUT = 30.0
MAX_REPORT = 1024 * 1024  # bytes

log = Logger()


class JobRunner:
    """Starts the processes of jobs."""

    def __init__(self, max_time: float, program: Sequence[str] = PROGRAM) -> None:
        """Start nothing yet.

        Args:
            max_time: Seconds that a job may run.
            program: Command that performs a task; see `rce.mapservice.job_program`.
        """
        self._max_time, self._program = max_time, program

    async def inspect(self, task: Task) -> int | None:
        """Inspect a recording.

        Returns:
            The number of its scans, or None if the recording does not say.

        Raises:
            InvalidRequest: The recording cannot be mapped, or not be opened within INSPECT_TIMEOUT.
        """
        try:
            report = await asyncio.wait_for(self._perform(task, None, lambda _: None), INSPECT_TIMEOUT)
        except TimeoutError:
            text = f"the recording could not be opened within {INSPECT_TIMEOUT:g} s"
            raise InvalidRequest(text, field="uploads") from None
        return report.total

    async def build(self, task: Task, log_file: Path, on_report: Callable[[Report], None]) -> None:
        """Map a recording. When this ends, for whatever reason, nothing of the job is left on the platform.

        Args:
            task: The task.
            log_file: File for the log of the process.
            on_report: Called with each report.

        Raises:
            TimedOut: The job took longer than `max_time`.
            RceError: The job failed.
        """
        clean = False

        def forward(report: Report) -> None:
            nonlocal clean
            clean = clean or report.clean
            on_report(report)

        try:
            await asyncio.wait_for(self._perform(task, log_file, forward), self._max_time)
        except TimeoutError:
            raise TimedOut(f"the job ran for more than {self._max_time:g} s") from None
        finally:
            if not clean:
                await self.clean(task)

    async def clean(self, task: Task) -> None:
        """Remove the environments of a job whose process could not remove them itself."""
        platform = task.platform
        assert platform is not None
        robot = Robot(
            platform.url,
            user=platform.user,
            robot=f"{task.name}_end",
            key=platform.key,
            ssl=trust_only(platform.trust),
        )
        try:
            async with asyncio.timeout(CLEANUP_TIMEOUT), robot:
                await remove_environments(robot, task, [*task.former, task.name])
        except (RceError, TimeoutError) as error:
            log.warn("environment {name} may still exist: {error}", name=task.name, error=str(error))

    async def _perform(self, task: Task, log_file: Path | None, on_report: Callable[[Report], None]) -> Report:
        with log_file.open("ab") if log_file else contextlib.nullcontext(asyncio.subprocess.DEVNULL) as errors:
            process = await asyncio.create_subprocess_exec(
                *self._program,
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=errors,
                limit=MAX_REPORT,
            )
        try:
            assert process.stdin is not None
            with contextlib.suppress(OSError, RuntimeError):  # of uvloop, if the process has ended
                process.stdin.write(msgspec.json.encode(task))
                process.stdin.close()
            return await self._read_reports(process, on_report)
        except asyncio.CancelledError:
            if task.platform is not None:  # else it has nothing to remove, and may be deep in a recording
                with contextlib.suppress(ProcessLookupError):
                    process.terminate()
                with contextlib.suppress(TimeoutError, RceError):
                    await asyncio.wait_for(self._read_reports(process, on_report), STOP_TIMEOUT)
            raise
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()

    @staticmethod
    async def _read_reports(process: asyncio.subprocess.Process, on_report: Callable[[Report], None]) -> Report:
        """Return the last report; raise its error, or InternalError if the process ended prematurely."""
        assert process.stdout is not None
        last = Report()
        async for line in process.stdout:
            try:
                last = msgspec.json.decode(line, type=Report)
            except MALFORMED:
                continue  # output of a library
            on_report(last)
        status = await process.wait()
        if last.error is not None:
            raise RceError.from_info(last.error)
        if not last.clean:
            raise InternalError(f"the process of the job ended with status {status}: see its log")
        return last
