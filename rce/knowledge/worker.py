"""A worker: the child process `rce.knowledge.sandbox` and the pipes to it."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterable, Sequence

from rce.errors import RceError, TimedOut, Unavailable
from rce.knowledge.messages import HEADER, Command, Evaluate, Failed, Read, Reply, pack, reply

PROGRAM = (sys.executable, "-P", "-m", "rce.knowledge.sandbox")
MARGIN = 60.0  # seconds beside the limit of the work: for the start, for loading, on a busy machine


class Worker:
    """A child process, started when it is needed. Calls must not overlap; whoever has a worker takes care of that.

    Attributes:
        loaded: Named graphs that the process has, with their stamps. The user of the worker keeps it up to date.
    """

    def __init__(self, program: Sequence[str] = PROGRAM) -> None:
        self.loaded: dict[str, int] = {}
        self._program = program
        self._process: asyncio.subprocess.Process | None = None

    async def send(self, commands: AsyncIterable[Command]) -> None:
        """Send commands that have no reply.

        Raises:
            Unavailable: The process has died, and with it what was loaded.
        """
        process = await self._running()
        try:
            assert process.stdin is not None
            async for each in commands:
                process.stdin.write(pack(each))
                await process.stdin.drain()
        except ConnectionError:
            await self.stop()
            raise _died() from None
        except BaseException:
            await self.stop()
            raise

    async def ask(self, work: Read | Evaluate) -> Reply:
        """Have work done and return the reply. A process that does not reply in time is killed.

        Raises:
            RceError: The work was refused or exceeded its limits, or the process died.
        """
        process = await self._running()
        try:
            async with asyncio.timeout(work.seconds + MARGIN):
                assert process.stdin is not None
                assert process.stdout is not None
                process.stdin.write(pack(work))
                await process.stdin.drain()
                head = await process.stdout.readexactly(HEADER.size)
                answer = reply(await process.stdout.readexactly(HEADER.unpack(head)[0]))
        except TimeoutError:
            await self.stop()
            raise TimedOut(f"stopped: no answer after {work.seconds + MARGIN:g} s") from None
        except (ConnectionError, asyncio.IncompleteReadError):
            await self.stop()
            raise _died() from None
        except BaseException:
            await self.stop()  # what it would say next belongs to this work
            raise
        if isinstance(answer, Failed):
            raise RceError.from_info(answer.error)
        return answer

    async def stop(self) -> None:
        """Kill the process."""
        process, self._process = self._process, None
        self.loaded = {}
        if process is not None and process.returncode is None:
            process.kill()
            await process.wait()

    async def _running(self) -> asyncio.subprocess.Process:
        if self._process is None or self._process.returncode is not None:
            self.loaded = {}
            pipe = asyncio.subprocess.PIPE
            self._process = await asyncio.create_subprocess_exec(*self._program, stdin=pipe, stdout=pipe)
        return self._process


def _died() -> Unavailable:
    return Unavailable("the process that reads texts and answers queries has died; try again")
