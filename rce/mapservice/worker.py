"""The processes that look at recordings and map them (`rce.mapservice.work`), as the service sees them."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec
from twisted.logger import Logger

from rce.client import Robot
from rce.errors import InternalError, InvalidRequest, RceError, TimedOut
from rce.mapservice.work import Report, Task, remove_environment, trusting

LOOK_TIMEOUT = 60.0  # seconds
STOP_TIMEOUT = 20.0  # until a process that was told to end is killed
CLEAN_TIMEOUT = 30.0
LINE_MOST = 1024 * 1024  # bytes of a report

log = Logger()


class Worker:
    """`longest`: seconds that a job may run."""

    def __init__(self, longest: float) -> None:
        self._longest = longest

    async def look(self, task: Task) -> int | None:
        """The number of scans, where that is quickly known. InvalidRequest where the recording cannot be mapped."""
        try:
            report = await asyncio.wait_for(self._perform(task, None, lambda _: None), LOOK_TIMEOUT)
        except TimeoutError:
            text = f"the recording could not be opened within {LOOK_TIMEOUT:g} s"
            raise InvalidRequest(text, field="uploads") from None
        return report.total

    async def build(self, task: Task, log_file: Path, heard: Callable[[Report], None]) -> None:
        """Map. Raises what went wrong; whatever ends it, nothing of the job is left in the platform."""
        clean = False

        def hear(report: Report) -> None:
            nonlocal clean
            clean = clean or report.clean
            heard(report)

        try:
            await asyncio.wait_for(self._perform(task, log_file, hear), self._longest)
        except TimeoutError:
            raise TimedOut(f"the job ran for more than {self._longest:g} s") from None
        finally:
            if not clean:
                await self.clean(task)

    async def clean(self, task: Task) -> None:
        """Take away what a job left whose process could not do so itself."""
        platform = task.platform
        assert platform is not None
        robot = Robot(
            platform.url,
            user=platform.user,
            robot=f"{task.name}_end",
            key=platform.key,
            ssl=trusting(platform.trust),
        )
        try:
            async with asyncio.timeout(CLEAN_TIMEOUT), robot:
                for name in (*task.former, task.name):
                    await remove_environment(robot, name)
        except (RceError, TimeoutError) as error:
            log.warn("environment {name} may be left: {error}", name=task.name, error=str(error))

    async def _perform(self, task: Task, log_file: Path | None, heard: Callable[[Report], None]) -> Report:
        with log_file.open("ab") if log_file else contextlib.nullcontext(asyncio.subprocess.DEVNULL) as errors:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-P", "-m", "rce.mapservice.work"),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=errors,
                limit=LINE_MOST,
            )
        try:
            assert process.stdin is not None
            process.stdin.write(msgspec.json.encode(task))
            process.stdin.close()
            return await self._listen(process, heard)
        except asyncio.CancelledError:
            with contextlib.suppress(ProcessLookupError):
                process.terminate()
            with contextlib.suppress(TimeoutError, RceError):
                await asyncio.wait_for(self._listen(process, heard), STOP_TIMEOUT)
            raise
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()

    @staticmethod
    async def _listen(process: asyncio.subprocess.Process, heard: Callable[[Report], None]) -> Report:
        """The last report. Raises the error of it, or InternalError if the process ended without one."""
        assert process.stdout is not None
        last = Report()
        async for line in process.stdout:
            try:
                last = msgspec.json.decode(line, type=Report)
            except msgspec.DecodeError:
                continue  # a library that prints
            heard(last)
        status = await process.wait()
        if last.error is not None:
            raise RceError.from_info(last.error)
        if not last.clean:
            raise InternalError(f"the process of the job ended with status {status}; its log may tell more")
        return last
