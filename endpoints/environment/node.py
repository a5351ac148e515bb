"""Process of one node, in a process group of its own, with its output in a log."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from twisted.logger import Logger

from endpoints.environment.arguments import enclave
from endpoints.environment.output_log import OutputLog
from endpoints.environment.prepared_node import ENCLAVE, Spare
from rce.control.calls.endpoints import NodeSpec
from rce.errors import StartFailed

LAUNCHER = Path(__file__).with_name("launcher.py")
STOP_STEPS = ((signal.SIGINT, 5.0), (signal.SIGTERM, 2.0), (signal.SIGKILL, 2.0))
OUTPUT_TIMEOUT = 0.5  # seconds for the rest of the output after the process has ended
GROUP_TIMEOUT = 2.0  # seconds until what is left of the process group is gone
CHUNK = 64 * 1024
POLL_INTERVAL = 0.01  # seconds

log = Logger()


class NodeProcess:
    """A running node.

    Attributes:
        stopping: True once `stop` was called.
        started: Monotonic time of the start.
        enclave: Enclave of its process in the ROS graph, unless its arguments name another one.
        over: Done with the exit status when the process and its group have ended.
    """

    def __init__(self, spec: NodeSpec, process: asyncio.subprocess.Process, output: OutputLog) -> None:
        self.spec = spec
        self.output = output
        self.stopping = False
        self.started = time.monotonic()
        self.enclave = enclave(spec.tag)
        self._process = process
        self.over: asyncio.Task[int]

    @classmethod
    async def start(
        cls,
        spec: NodeSpec,
        command: Sequence[str],
        environment: Mapping[str, str],
        directory: Path,
        output: OutputLog,
        ended: Callable[[NodeProcess, int], None],
        spare: Spare | None = None,
    ) -> NodeProcess:
        """Start a node; return when its command is executing.

        Args:
            spec: The node.
            command: Command and arguments.
            environment: Variables of the process.
            directory: Working directory.
            output: Log of the output, closed at the end.
            ended: Called with the node and its exit status when it has ended, for whatever reason.
            spare: Interpreter that becomes the node, which it suits.

        Raises:
            StartFailed: The command cannot be executed.
        """
        if spare is not None:
            node = cls(spec, spare.take(command, environment, directory), output)
            node.enclave = ENCLAVE
            node.over = asyncio.create_task(node._watch(ended))
            return node
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
        """Send SIGINT, SIGTERM and SIGKILL in turn until the whole process group has ended."""
        self.stopping = True
        for number, timeout in STOP_STEPS:
            self._signal(number)
            try:
                await asyncio.wait_for(asyncio.shield(self.over), timeout)
                return
            except TimeoutError:
                log.info("node {node} has not ended after {signal}", node=self.spec.tag, signal=number.name)

    async def _watch(self, ended: Callable[[NodeProcess, int], None]) -> int:
        copying = asyncio.create_task(self._copy())
        status = await self._process.wait()
        await self._end_group()
        await asyncio.wait([copying], timeout=OUTPUT_TIMEOUT)
        copying.cancel()
        ended(self, status)
        self.output.close()
        return status

    async def _copy(self) -> None:
        assert self._process.stdout is not None
        while chunk := await self._process.stdout.read(CHUNK):
            self.output.write(chunk)

    async def _end_group(self) -> None:
        """Kill the processes that the node has started and left behind."""
        until = time.monotonic() + GROUP_TIMEOUT
        while self._signal(signal.SIGKILL) and _has_running_members(self._process.pid) and time.monotonic() < until:  # noqa: ASYNC110
            await asyncio.sleep(POLL_INTERVAL)

    def _signal(self, number: signal.Signals) -> bool:
        """Send a signal to the process group; return False if the group does not exist."""
        try:
            os.killpg(self._process.pid, number)
        except ProcessLookupError:
            return False
        return True


def _has_running_members(group: int) -> bool:
    """Return True if a process group has members other than zombies, which stay where process 1 does not reap them."""
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
