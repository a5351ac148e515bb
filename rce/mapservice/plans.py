"""Plans on the maps of jobs: child processes (`rce.mapservice.plan_program`) within limits."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import msgspec

from rce.api.map_jobs import Plan, PlanRequest
from rce.errors import MALFORMED, InternalError, InvalidRequest, LimitExceeded, NotFound, RceError, TimedOut
from rce.mapservice.jobs import Jobs
from rce.mapservice.plan_program import PlanAnswer, PlanTask

PROGRAM = (sys.executable, "-P", "-m", "rce.mapservice.plan_program")
MAP, IMAGE = "map.yaml", "map.pgm"
AT_ONCE, PER_USER = 2, 4  # processes of all users, and plans of one user that run or wait
OVERHEAD = 25.0  # seconds beside planning: to start, to read a large map, to compile kernels where none are kept


class Plans:
    """Planner on the maps of finished jobs."""

    def __init__(self, jobs: Jobs, program: Sequence[str] = PROGRAM, overhead: float = OVERHEAD) -> None:
        """Plan on the maps of `jobs`.

        Args:
            jobs: The jobs.
            program: Command that plans; see `rce.mapservice.plan_program`.
            overhead: Seconds that a process may take beside the time of the plan.
        """
        self._jobs, self._program, self._overhead = jobs, program, overhead
        self._turns = asyncio.Semaphore(AT_ONCE)
        self._pending: Counter[str] = Counter()

    async def plan(self, user: str, job: str, request: PlanRequest) -> Plan:
        """Plan a path on the map of a job.

        Raises:
            NotFound: The user has no such job.
            InvalidRequest: The job has no map in the plane yet.
            LimitExceeded: Too many plans of this user run or wait.
            TimedOut: The process did not end in time.
            RceError: There is no path; the code is `no_path`.
        """
        path = self._map(user, job)
        if self._pending[user] >= PER_USER:
            text = f"{PER_USER} of your plans are running or waiting, which is the limit: wait for their answers"
            raise LimitExceeded(text, limit=PER_USER)
        self._pending[user] += 1
        try:
            async with self._turns:
                return await self._perform(PlanTask(str(path), request))
        finally:
            self._pending[user] -= 1

    def _map(self, user: str, job: str) -> Path:
        found = self._jobs.get(user, job)
        try:
            self._jobs.file(user, job, IMAGE)
            return self._jobs.file(user, job, MAP)
        except NotFound:
            text = f"job {job} is {found.state} and has no map in the plane ({MAP}): plan on one that is done"
            raise InvalidRequest(text, field="job") from None

    async def _perform(self, task: PlanTask) -> Plan:
        process = await asyncio.create_subprocess_exec(
            *self._program,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
        )
        seconds = task.request.max_planning_time + self._overhead
        try:
            output, _ = await asyncio.wait_for(process.communicate(msgspec.json.encode(task)), seconds)
        except TimeoutError:
            raise TimedOut(f"the plan took more than {seconds:g} s") from None
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
        return _decode(output, process.returncode)


def _decode(output: bytes, status: int | None) -> Plan:
    try:
        answer = msgspec.json.decode(output, type=PlanAnswer)
    except MALFORMED:
        raise InternalError(f"the process of the plan ended with status {status}") from None
    if answer.error is not None:
        raise RceError.from_info(answer.error)
    if answer.plan is None:
        raise InternalError("the process of the plan has sent no answer")
    return answer.plan
