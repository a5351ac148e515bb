"""Receiver of recordings: a socket for each environment, at which its endpoint appends to the store.

See `rce.bag.transfer`. A thread for each recording copies from the socket to the disk, so that no other recording and
no environment waits for a slow one.
"""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path

from twisted.logger import Logger

from containers.recordings.store import OpenRecording, RecordingStore
from rce.bag.transfer import MAX_LINE, SOCKET, TIMEOUT, Verdict
from rce.control.calls.recordings import RecordingQuota
from rce.errors import DiskFull, RceError, TimedOut, Unavailable, disk_full
from rce.net.sockets import bind_unix_socket

BUFFER = 1024 * 1024  # bytes that are received at once
MOST = 32  # connections of one environment
BACKLOG = 16

log = Logger()
AskQuota = Callable[[str, str], Awaitable[RecordingQuota]]
"""Asks the Master whether a recorder (its tag) of an environment (`user/tag`) may record."""


class RecordingReceiver:
    """Accepts the recordings of environments. Without a store, as in tests of engines, it accepts none."""

    def __init__(self, store: RecordingStore | None = None) -> None:
        self.ask_quota: AskQuota = _no_quota
        self._store = store
        self._sockets: dict[str, socket.socket] = {}  # that listen, by environment
        self._accepting: dict[str, asyncio.Task[None]] = {}
        self._connections: dict[str, set[socket.socket]] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def active(self) -> bool:
        """True if recordings are accepted."""
        return self._store is not None

    def add_environment(self, name: str, directory: Path) -> None:
        """Open the socket of an environment in a directory that it sees.

        Raises:
            OSError: The socket cannot be opened.
        """
        if self._store is None:
            return
        self.remove_environment(name)
        listener = bind_unix_socket(directory / SOCKET, 0o666)  # the environment may run as any user
        listener.listen(BACKLOG)
        listener.setblocking(False)
        self._sockets[name] = listener
        self._connections[name] = set()
        self._accepting[name] = asyncio.create_task(self._accept(name, listener, self._store))

    def remove_environment(self, name: str) -> None:
        """Close the socket of an environment; what it still records is cut off."""
        if name in self._sockets:
            self._accepting.pop(name).cancel()
            self._sockets.pop(name).close()
            for connection in self._connections.pop(name):
                with suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)

    async def close(self) -> None:
        """Close all sockets, and wait for the ends of all recordings."""
        for name in list(self._sockets):
            self.remove_environment(name)
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _accept(self, name: str, listener: socket.socket, store: RecordingStore) -> None:
        loop = asyncio.get_running_loop()
        while True:
            connection, _ = await loop.sock_accept(listener)
            connections = self._connections[name]
            if len(connections) >= MOST:
                connection.close()
                continue
            connections.add(connection)
            task = asyncio.create_task(self._serve(name, connection, store))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _serve(self, name: str, connection: socket.socket, store: RecordingStore) -> None:
        try:
            connection.setblocking(False)
            recording = await self._begin(name, connection, store)
            if recording is not None:
                connection.settimeout(None)
                await _in_thread(lambda: receive(connection, recording))
        except OSError as error:
            log.info("a recording of {name} ended: {error}", name=name, error=str(error))
        finally:
            self._connections.get(name, set()).discard(connection)
            connection.close()

    async def _begin(self, name: str, connection: socket.socket, store: RecordingStore) -> OpenRecording | None:
        """Read which recorder this is, and begin its file; return None if it may not record."""
        loop = asyncio.get_running_loop()
        with suppress(TimeoutError):
            async with asyncio.timeout(TIMEOUT):
                line = b""
                while not line.endswith(b"\n"):
                    data = await loop.sock_recv(connection, MAX_LINE)
                    line += data
                    if not data or len(line) > MAX_LINE:
                        return None
                recorder = line.decode("ascii", "replace").strip()
                verdict = Verdict()
                recording = None
                try:
                    recording = store.begin(name, recorder, await self.ask_quota(name, recorder))
                except (RceError, OSError) as error:
                    log.info("{name} may not record: {error}", name=name, recorder=recorder, error=str(error))
                    if isinstance(error, Unavailable | TimedOut) and not isinstance(error, DiskFull):
                        return None  # the Master is away: without a verdict, the environment tries again
                    verdict = _verdict(error)
                await loop.sock_sendall(connection, verdict.line())
                return recording
        return None


def _verdict(error: RceError | OSError) -> Verdict:
    if isinstance(error, RceError):
        return Verdict(error.info)
    return Verdict((disk_full(error) or Unavailable(f"the recording broke off: {error}")).info)


async def _no_quota(environment: str, recorder: str) -> RecordingQuota:
    raise Unavailable("this task set cannot ask the Master for the quota of recordings")


def receive(connection: socket.socket, recording: OpenRecording) -> None:
    """Copy from a socket to a recording until the other side ends, or the recording takes no more. Blocks."""
    buffer = memoryview(bytearray(BUFFER))
    verdict = Verdict()
    try:
        while count := connection.recv_into(buffer):
            recording.write(buffer[:count])
    except (RceError, OSError) as error:
        verdict = _verdict(error)
    recording.end()
    connection.sendall(verdict.line())


async def _in_thread(work: Callable[[], None]) -> None:
    """Run `work` in a thread of its own: the loop's executor has only a few, and a recording may last for days."""
    loop = asyncio.get_running_loop()
    done: asyncio.Future[None] = loop.create_future()

    def run() -> None:
        try:
            work()
        except Exception as error:  # noqa: BLE001  # it is raised in the caller
            failure = error
            loop.call_soon_threadsafe(lambda: None if done.done() else done.set_exception(failure))
        else:
            loop.call_soon_threadsafe(lambda: None if done.done() else done.set_result(None))

    threading.Thread(target=run, name="recording", daemon=True).start()
    await asyncio.shield(done)
