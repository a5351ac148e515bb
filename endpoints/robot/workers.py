"""Processes that convert large messages, so that the event loop, and with it everybody else's messages, need not wait.

Each user has a queue, and the users take turns. One user never has all processes: others begin at once.
"""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import struct
import subprocess
import sys
from collections import Counter, OrderedDict, deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from zlib import crc32

import msgspec
from twisted.logger import Logger

from converters import Recipe, Wire, custom_files
from converters.custom_files import Description
from endpoints.robot import worker
from endpoints.robot.worker import Answer, Converted, Decode, Describe, Described, Encode, Failed, Request
from rce.errors import MALFORMED, LimitExceeded, RceError
from rce.process.metrics import Family, counter_family, gauge_family
from rce.protocol.blobs import Buffer

MAX_SECONDS = 60  # of one conversion
STREAM_WORKERS = 2
SOCKET_BUFFER = 1 << 20  # bytes
PROGRAM = ("-P", "-m", worker.__name__)

log = Logger()


class Worker:
    """One process, which starts with its first request and again after it has failed. `call` is used in a thread."""

    def __init__(self, converters: str = "") -> None:
        self._converters = converters
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None

    def call(self, request: Request, buffers: Sequence[Buffer]) -> tuple[Answer, list[bytes]]:
        """Return the answer to a request and its buffers.

        Raises:
            LimitExceeded: It took too long, or the process died of it.
        """
        sock = self._socket or self._start()
        try:
            worker.send(sock, request, buffers)
            head, results = worker.receive(sock)
            return msgspec.msgpack.decode(head, type=Answer), results
        except (OSError, EOFError, *MALFORMED) as error:
            self.stop()
            reason = f"took more than {MAX_SECONDS} s" if isinstance(error, BlockingIOError) else "ended the converter"
            raise LimitExceeded(f"the conversion of this message {reason}: send less at a time") from None

    def _start(self) -> socket.socket:
        ours, theirs = socket.socketpair()
        with theirs:
            for option in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):
                ours.setsockopt(socket.SOL_SOCKET, option, struct.pack("ll", MAX_SECONDS, 0))
            for end in (ours, theirs):
                end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BUFFER)
            self._process = subprocess.Popen(
                [sys.executable, *PROGRAM, str(theirs.fileno()), self._converters],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )
        self._socket = ours
        return ours

    def kill(self) -> None:
        """Kill the process, so that `call` fails."""
        if self._process is not None:
            self._process.kill()

    def stop(self) -> None:
        """Kill the process, if there is one, and wait for its end."""
        if self._socket is not None and self._process is not None:
            self._socket.close()
            self._process.kill()
            status = self._process.wait()
            if status not in (0, -signal.SIGKILL):
                log.warn("a converter of messages ended with status {status}", status=status)
            self._process = self._socket = None


@dataclass(slots=True)
class _Job:
    request: Request
    buffers: Sequence[Buffer]
    done: asyncio.Future[tuple[Answer, list[bytes]]]


class StreamWorker:
    """One process for conversions with state, one after the other. It starts when it is needed."""

    def __init__(self, converters: str = "") -> None:
        self._worker = Worker(converters)
        self._thread = ThreadPoolExecutor(1, "stream")
        self._running = False

    async def ask(self, request: Request, buffers: Sequence[Buffer]) -> tuple[Answer, list[bytes]]:
        """Return the answer to a request and its buffers; requests are answered in their order."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._call, request, buffers)

    def _call(self, request: Request, buffers: Sequence[Buffer]) -> tuple[Answer, list[bytes]]:
        self._running = True
        try:
            return self._worker.call(request, buffers)
        finally:
            self._running = False

    def close(self) -> None:
        """End the process; a conversion that runs fails."""
        self._thread.shutdown(wait=False, cancel_futures=True)
        if self._running:
            self._worker.kill()  # its thread does the rest
        else:
            self._worker.stop()


class Workers:
    """A few workers, shared by all users."""

    def __init__(self, count: int = 0, converters: str = "") -> None:
        """Make workers, which start when they are needed.

        Args:
            count: Number of workers; by default that of the processors, from 2 to 4.
            converters: Path of users' converters.
        """
        self._converters = converters
        self._count = count or max(2, min(4, os.cpu_count() or 2))
        self._threads = ThreadPoolExecutor(self._count, "worker")
        self._idle = [Worker(converters) for _ in range(self._count)]
        self._all = list(self._idle)
        self._waiting: OrderedDict[str, deque[_Job]] = OrderedDict()  # by user, whose turn is next first
        self._running: Counter[str] = Counter()  # by user
        self._tasks: set[asyncio.Task[None]] = set()
        self._streams = [StreamWorker(converters) for _ in range(STREAM_WORKERS)]
        self._converted = 0

    async def converters(self) -> list[Description]:
        """Return the users' converters.

        Raises:
            StartFailed: One cannot be loaded.
        """
        if not custom_files.wanted(self._converters):
            return []
        answer, _ = await self._ask("", Describe(), [])
        return answer.converters if isinstance(answer, Described) else []

    async def encode(self, user: str, recipe: Recipe, wire: Wire) -> Buffer:
        """Convert a message to CDR.

        Raises:
            ConversionError: The message does not fit its type.
            LimitExceeded: The conversion takes too much time or memory.
        """
        request = Encode(recipe, wire.is_blob, list(wire.blobs))
        _, (cdr,) = await self._convert(user, recipe, request, [memoryview(wire.raw), *wire.blobs.values()])
        return cdr

    async def decode(self, user: str, recipe: Recipe, cdr: Buffer, *, key: bool = False) -> Wire:
        """Convert CDR to the form of a robot, with `key` to a key frame of video; raises the errors of `encode`."""
        answer, (raw, *blobs) = await self._convert(user, recipe, Decode(recipe, key), [cdr])
        assert isinstance(answer, Converted)  # `_ask` raises a failure
        return Wire(answer.is_blob, raw, dict(zip(answer.blobs, blobs, strict=True)))

    async def _convert(
        self, user: str, recipe: Recipe, request: Request, buffers: Sequence[Buffer]
    ) -> tuple[Answer, list[bytes]]:
        self._converted += 1
        if not recipe.stream:
            return await self._ask(user, request, buffers)
        return _result(await self._stream(recipe.stream).ask(request, buffers))

    def _stream(self, stream: str) -> StreamWorker:
        """Return the worker of a stream, which is always the same one: it has the state."""
        return self._streams[crc32(stream.encode()) % len(self._streams)]

    async def _ask(self, user: str, request: Request, buffers: Sequence[Buffer]) -> tuple[Answer, list[bytes]]:
        done = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(user, deque()).append(_Job(request, buffers, done))
        self._pump()
        return _result(await done)

    def _pump(self) -> None:
        """Start jobs on idle workers, one of each user in turn."""
        share = max(1, self._count - 1)
        while self._idle and (user := next((u for u in self._waiting if self._running[u] < share), None)) is not None:
            queue = self._waiting.pop(user)
            job = queue.popleft()
            if queue:
                self._waiting[user] = queue  # behind the others
            if job.done.cancelled():
                continue
            self._running[user] += 1
            task = asyncio.create_task(self._execute(user, self._idle.pop(), job))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _execute(self, user: str, by: Worker, job: _Job) -> None:
        loop = asyncio.get_running_loop()
        try:
            result = await loop.run_in_executor(self._threads, by.call, job.request, job.buffers)
            if not job.done.done():
                job.done.set_result(result)
        except Exception as error:  # noqa: BLE001  # whatever it is belongs to the one who waits
            if not job.done.done():
                job.done.set_exception(error)
        finally:
            self._idle.append(by)
            self._running[user] -= 1
            if not self._running[user]:
                del self._running[user]
            self._pump()

    def families(self) -> list[Family]:
        """Return the metrics."""
        numbers: dict[tuple[str, ...], float] = {
            ("running",): self._running.total(),
            ("waiting",): sum(map(len, self._waiting.values())),
        }
        return [
            gauge_family("rce_conversions", "Conversions of large messages", ["state"], numbers),
            counter_family("rce_converted", "Large messages that were converted", [], {(): self._converted}),
        ]

    def close(self) -> None:
        """End the processes; conversions that run or wait fail."""
        for queue in self._waiting.values():
            for job in queue:
                job.done.cancel()
        self._waiting.clear()
        for each in self._all:
            if each in self._idle:
                each.stop()
            else:
                each.kill()  # its thread does the rest
        self._threads.shutdown(wait=False)
        for stream in self._streams:
            stream.close()


def _result(result: tuple[Answer, list[bytes]]) -> tuple[Answer, list[bytes]]:
    """Return the result of a conversion, or raise its error."""
    if isinstance(result[0], Failed):
        raise RceError.from_info(result[0].error)
    return result
