"""Supervision of a child process: start, readiness, restart after a crash, and stop."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import signal
import sys
from collections.abc import Callable
from typing import IO

from rce.errors import StartFailed
from rce.process import programs
from rce.process.ready import Ready, parse

START_TIMEOUT = 120.0  # seconds; a process that ends is noticed at once, so this is for one that hangs
STOP_TIMEOUT = 30.0
RESTART_DELAY_MIN, RESTART_DELAY_MAX = 0.1, 5.0
STABLE_AFTER = 10.0  # seconds; a process that ran this long is restarted with the shortest delay
PR_SET_PDEATHSIG = 1


class ManagedProcess:
    """Child process that is restarted until it is stopped."""

    def __init__(self, name: str, arguments: Callable[[], list[str]], secret: dict[str, str], log: IO[str]) -> None:
        """Describe a process, which `start` starts.

        Args:
            name: Name of the program.
            arguments: Makes the command line of each start.
            secret: Additional environment variables, for secrets.
            log: File for the standard error of the process and for messages about restarts.
        """
        self.name = name
        self.ready: Ready | None = None
        self._arguments = arguments
        self._environment = os.environ | secret
        self._log = log
        self._process: asyncio.subprocess.Process | None = None
        self._supervisor: asyncio.Task[None] | None = None
        self._announced = asyncio.Event()

    async def start(self) -> Ready:
        """Start the process and wait until it is ready.

        Raises:
            StartFailed: The process ended, and its output says why, or it was not ready within START_TIMEOUT.
        """
        await self._launch()
        self._supervisor = asyncio.create_task(self._supervise())
        announced = asyncio.create_task(self._announced.wait())
        await asyncio.wait({announced, self._supervisor}, timeout=START_TIMEOUT, return_when=asyncio.FIRST_COMPLETED)
        announced.cancel()
        if self.ready is None:
            raise StartFailed(f"rce {self.name} did not start: {self._reason()}")
        return self.ready

    def _reason(self) -> str:
        status = self._process.returncode if self._process is not None else None
        if status is None:
            return f"it was not ready after {START_TIMEOUT:g} s; if this machine is busy, try again"
        return f"it ended with status {status}; see its output above"

    @property
    def pid(self) -> int:
        """Process id; it changes with each restart. Only valid once the process was started."""
        assert self._process is not None
        return self._process.pid

    async def _launch(self) -> None:
        command = programs.command(self.name) + self._arguments()
        self._process = await asyncio.create_subprocess_exec(
            *command,
            stdout=asyncio.subprocess.PIPE,
            stderr=self._log,
            env=self._environment,
            preexec_fn=_end_with_parent,
            start_new_session=True,  # Ctrl-C reaches only this process, which stops its children in order
        )

    async def _supervise(self) -> None:
        delay = RESTART_DELAY_MIN
        loop = asyncio.get_running_loop()
        while True:
            assert self._process is not None
            began = loop.time()
            await self._read_output(self._process)
            status = await self._process.wait()
            if self.ready is None:
                return
            print(f"rce {self.name} ended with status {status}: restarting it", file=self._log, flush=True)
            stable = loop.time() - began > STABLE_AFTER
            delay = RESTART_DELAY_MIN if stable else min(2 * delay, RESTART_DELAY_MAX)
            await asyncio.sleep(delay)
            await self._launch()

    async def _read_output(self, process: asyncio.subprocess.Process) -> None:
        assert process.stdout is not None
        async for line in process.stdout:
            ready = parse(line)
            if ready is None:
                sys.stdout.buffer.write(line)
                sys.stdout.flush()
            elif self.ready is None:  # after a restart the ports are the same
                self.ready = ready
                self._announced.set()

    async def stop(self) -> None:
        """Terminate the process; kill it if it does not end within STOP_TIMEOUT."""
        if self._supervisor is not None:
            self._supervisor.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._supervisor
        process = self._process
        if process is None or process.returncode is not None:
            return
        process.terminate()
        try:
            await asyncio.wait_for(process.wait(), STOP_TIMEOUT)
        except TimeoutError:
            process.kill()
            await process.wait()


def _end_with_parent() -> None:
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
