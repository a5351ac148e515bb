"""One node: a process in a group of its own, its output in a log."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from twisted.logger import Logger

from endpoints.environment.nodelog import NodeLog
from rce.calls.endpoints import NodeSpec
from rce.errors import StartFailed

LAUNCHER = Path(__file__).with_name("launcher.py")
STOP_STEPS = ((signal.SIGINT, 5.0), (signal.SIGTERM, 2.0), (signal.SIGKILL, 2.0))
LAST_WORDS = 0.5  # seconds for the rest of the output after the process has ended
GROUP_PATIENCE = 2.0
CHUNK = 64 * 1024
LOOK = 0.01

log = Logger()


class NodeProcess:
    """A running node. `ended` gets it when its process has ended, whoever ended it."""

    def __init__(self, spec: NodeSpec, process: asyncio.subprocess.Process, output: NodeLog) -> None:
        self.spec = spec
        self.output = output
        self.stopping = False
        self.started = time.monotonic()
        self._process = process
        self.over: asyncio.Task[int]

    @classmethod
    async def start(
        cls,
        spec: NodeSpec,
        command: Sequence[str],
        environment: Mapping[str, str],
        directory: Path,
        output: NodeLog,
        ended: Callable[[NodeProcess, int], None],
    ) -> NodeProcess:
        """Returns when the command runs; StartFailed with the reason when it cannot."""
        read, write = os.pipe()
        try:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-I", "-S", str(LAUNCHER), str(os.getpid()), str(write), *command),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
                cwd=directory,
                env=environment,
                start_new_session=True,
                pass_fds=[write],
            )
        except OSError as error:
            os.close(read)
            raise StartFailed(f"node {spec.tag} did not start: {error}") from None
        finally:
            os.close(write)
        node = cls(spec, process, output)
        reason = await asyncio.to_thread(_read_all, read)
        if reason:
            await process.wait()
            raise StartFailed(f"node {spec.tag} did not start: {reason}")
        node.over = asyncio.create_task(node._watch(ended))
        return node

    async def stop(self) -> None:
        """SIGINT, SIGTERM, SIGKILL, until nothing of the process group is left."""
        self.stopping = True
        for number, patience in STOP_STEPS:
            self._signal(number)
            try:
                await asyncio.wait_for(asyncio.shield(self.over), patience)
                return
            except TimeoutError:
                log.info("node {node} has not ended on {signal}", node=self.spec.tag, signal=number.name)

    async def _watch(self, ended: Callable[[NodeProcess, int], None]) -> int:
        copying = asyncio.create_task(self._copy())
        status = await self._process.wait()
        await self._end_group()
        await asyncio.wait([copying], timeout=LAST_WORDS)
        copying.cancel()
        ended(self, status)
        self.output.close()
        return status

    async def _copy(self) -> None:
        assert self._process.stdout is not None
        while chunk := await self._process.stdout.read(CHUNK):
            self.output.write(chunk)

    async def _end_group(self) -> None:
        """What a node has started goes with it."""
        until = time.monotonic() + GROUP_PATIENCE
        while self._signal(signal.SIGKILL) and _lives(self._process.pid) and time.monotonic() < until:  # noqa: ASYNC110
            await asyncio.sleep(LOOK)

    def _signal(self, number: signal.Signals) -> bool:
        """Send a signal to the process group; whether there was one."""
        try:
            os.killpg(self._process.pid, number)
        except ProcessLookupError:
            return False
        return True


def _lives(group: int) -> bool:
    """Whether a process group has members that are no zombies: these stay where process 1 does not collect them."""
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, member_of = path.read_text().rpartition(")")[2].split()[:3]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(member_of) == group and state not in "ZX":
            return True
    return False


def _read_all(descriptor: int) -> str:
    with os.fdopen(descriptor, "rb") as report:
        return report.read().decode(errors="replace")
