"""Programs that are started again whenever they end, as a service manager does, unless they are held."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import IO

RESTART_DELAY = 0.5  # seconds
STOP_TIMEOUT = 20.0


class Program:
    """A program.

    Attributes:
        name: Its name.
        starts: How often it was started.
        ended: How often it ended by itself or by a signal.
    """

    def __init__(
        self,
        name: str,
        command: Callable[[], Sequence[str]],
        environment: Mapping[str, str],
        log: IO[str],
        output: Callable[[str], None],
    ) -> None:
        """Describe a program, which `start` starts.

        Args:
            name: Its name.
            command: Makes the command line of each start.
            environment: Additional environment variables.
            log: File for its standard error.
            output: Called with each line of its standard output.
        """
        self.name = name
        self.starts = self.ended = 0
        self._command = command
        self._environment = os.environ | environment
        self._log = log
        self._output = output
        self._process: asyncio.subprocess.Process | None = None
        self._allowed = asyncio.Event()
        self._allowed.set()
        self._task: asyncio.Task[None] | None = None

    @property
    def pid(self) -> int:
        """Process id; 0 if it does not run."""
        return self._process.pid if self._process is not None and self._process.returncode is None else 0

    def start(self) -> None:
        """Keep it running from now on."""
        self._task = asyncio.create_task(self._keep())

    def hold(self) -> None:
        """Do not start it again once it has ended, until `release`."""
        self._allowed.clear()

    def release(self) -> None:
        """Start it again."""
        self._allowed.set()

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal, if it runs."""
        if self.pid:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    async def stop(self) -> None:
        """End it, and kill it if it does not end."""
        self.hold()
        self.signal(signal.SIGCONT)
        self.signal(signal.SIGTERM)
        if self._process is not None:
            try:
                await asyncio.wait_for(self._process.wait(), STOP_TIMEOUT)
            except TimeoutError:
                self.signal(signal.SIGKILL)
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _keep(self) -> None:
        while True:
            await self._allowed.wait()
            self._process = await asyncio.create_subprocess_exec(
                *self._command(), stdout=asyncio.subprocess.PIPE, stderr=self._log, env=self._environment
            )
            self.starts += 1
            assert self._process.stdout is not None
            async for line in self._process.stdout:
                self._output(line.decode(errors="replace"))
            await self._process.wait()
            self.ended += 1
            await asyncio.sleep(RESTART_DELAY)
