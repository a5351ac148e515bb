"""A robot that speaks the original protocol: JSON over a WebSocket, without RCE's client library."""

from __future__ import annotations

import asyncio
import fcntl
import hashlib
import json
import socket
import struct
import termios
import urllib.error
import urllib.request
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlencode

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

Received = dict[str, Any] | bytes
PASSWORD = hashlib.sha256(b"testUser").hexdigest()
TIMEOUT = 60.0


async def get(url: str, **query: str) -> tuple[int, str, str]:
    """Send an HTTP GET and return status, content type and body."""

    def fetch() -> tuple[int, str, str]:
        try:
            with urllib.request.urlopen(f"{url}?{urlencode(query)}", timeout=TIMEOUT) as response:
                return response.status, response.headers["Content-Type"], response.read().decode()
        except urllib.error.HTTPError as error:
            with error:
                return error.code, error.headers["Content-Type"], error.read().decode()

    return await asyncio.to_thread(fetch)


def status(tag: str, value: bool) -> dict[str, Any]:
    """Return the ST frame of an interface."""
    return {"type": "ST", "data": {"topic": "iu", "iTag": tag, "status": value}}


class OriginalRobot:
    """A robot, connected within its context. Frames wait in `received` until a test takes them."""

    def __init__(self, url: str, name: str) -> None:
        self.name = name
        self.received: list[Received] = []
        self.reading = asyncio.Event()
        """While it is clear, the robot does not read from its socket."""
        self.reading.set()
        self._url = url
        self._socket: ClientConnection
        self._more = asyncio.Condition()

    async def __aenter__(self) -> Self:
        code, _, body = await get(self._url, userID="testUser", version="20130902")
        assert code == 200, body
        query = urlencode({"userID": "testUser", "robotID": self.name, "password": PASSWORD})
        self._socket = await connect(
            f"{json.loads(body)['url']}?{query}",
            max_size=None,
            compression=None,
            open_timeout=TIMEOUT,
            ping_interval=None,  # the answer to a ping is not read while `reading` is clear
        )
        self._reader = asyncio.create_task(self._read())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._socket.close()
        await self._reader

    async def _read(self) -> None:
        try:
            async for frame in self._socket:
                await self.reading.wait()
                async with self._more:
                    self.received.append(frame if isinstance(frame, bytes) else json.loads(frame))
                    self._more.notify_all()
        except ConnectionClosed:
            pass

    async def send(self, *frames: dict[str, Any] | bytes | str) -> None:
        for frame in frames:
            await self._socket.send(json.dumps(frame) if isinstance(frame, dict) else frame)

    async def take(self, matches: Callable[[Any], object], timeout: float = TIMEOUT) -> Any:  # noqa: ASYNC109
        """Wait for the first frame that `matches`, and remove it from `received`."""

        def found() -> bool:
            return any(matches(frame) for frame in self.received)

        async with self._more:
            try:
                await asyncio.wait_for(self._more.wait_for(found), timeout)
            except TimeoutError:
                raise AssertionError(f"no such frame within {timeout:g} s, but {self.received}") from None
            frame = next(frame for frame in self.received if matches(frame))
            self.received.remove(frame)
            return frame

    async def take_frame(self, *frames: dict[str, Any]) -> None:
        """Wait for these frames, in any order."""
        for expected in frames:
            await self.take(expected.__eq__)

    async def take_error(self) -> str:
        frame = await self.take(lambda frame: isinstance(frame, dict) and frame["type"] == "ER")
        assert set(frame) == {"type", "data"}
        assert isinstance(frame["data"], str)
        return str(frame["data"])

    async def take_data(self, tag: str, timeout: float = TIMEOUT) -> dict[str, Any]:  # noqa: ASYNC109
        """Wait for the next DM of an interface and return its `data`."""
        frame = await self.take(
            lambda frame: isinstance(frame, dict) and frame["type"] == "DM" and frame["data"]["iTag"] == tag, timeout
        )
        data: dict[str, Any] = frame["data"]
        return data

    async def call(self, tag: str, type_name: str, value: Any, msg_id: str) -> dict[str, Any]:
        """Call the service of a node until it answers, and return the `data` of the answer.

        The node may still be starting, and its first answer is lost if DDS discovery has not finished. Each call ends
        with an answer or an error.
        """

        def ends(frame: Any) -> bool:
            if not isinstance(frame, dict):
                return False
            failed = frame["type"] == "ER" and ("did not appear" in frame["data"] or "did not answer" in frame["data"])
            return failed or (frame["type"] == "DM" and frame["data"]["iTag"] == tag)

        async with asyncio.timeout(2 * TIMEOUT):
            while True:
                await self.send(message(tag, type_name, value, msg_id))
                frame = await self.take(ends)
                if frame["type"] == "DM":
                    data: dict[str, Any] = frame["data"]
                    return data

    async def take_blob(self, name: str) -> bytes:
        frame: bytes = await self.take(lambda frame: isinstance(frame, bytes) and frame[:32] == name.encode())
        return frame[32:]

    async def commands_processed(self) -> None:
        """Wait until the Master has processed all commands sent so far: it refuses this last one, in order."""
        await self.send(connection("nobody/nothing", "nobody/nowhere"))
        await self.take(lambda frame: isinstance(frame, dict) and frame["type"] == "ER" and "nobody" in frame["data"])

    async def wait_until_stalled(self) -> None:
        """Wait until nothing arrives any more while the robot does not read: all buffers on the way are full."""
        assert not self.reading.is_set()
        raw: socket.socket = self._socket.transport.get_extra_info("socket")
        waiting, previous = -1, -2
        async with asyncio.timeout(TIMEOUT):
            while waiting <= 0 or waiting != previous:
                await asyncio.sleep(0.3)
                waiting, previous = _unread_bytes(raw.fileno()), waiting

    def abort(self) -> None:
        """Reset the connection without a close frame."""
        raw: socket.socket = self._socket.transport.get_extra_info("socket")
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._socket.transport.abort()


def _unread_bytes(descriptor: int) -> int:
    """Return the number of bytes in a socket's receive buffer."""
    return int(struct.unpack("i", fcntl.ioctl(descriptor, termios.FIONREAD, b"\0" * 4))[0])


def container(tag: str, **data: Any) -> dict[str, Any]:
    return {"type": "CC", "data": {"containerTag": tag, "containerData": {"size": 1, **data}}}


def destroy(tag: str) -> dict[str, Any]:
    return {"type": "DC", "data": {"containerTag": tag}}


def configure(what: str, **item: Any) -> dict[str, Any]:
    """Return a CN frame with one item, as clients of the original send it."""
    return {"type": "CN", "data": {what: [item]}}


def node(container: str, tag: str, exe: str, **more: Any) -> dict[str, Any]:
    return configure("addNodes", containerTag=container, nodeTag=tag, pkg="Test", exe=exe, **more)


def interface(endpoint: str, tag: str, kind: str, type_name: str, **more: Any) -> dict[str, Any]:
    return configure(
        "addInterfaces", endpointTag=endpoint, interfaceTag=tag, interfaceType=kind, className=type_name, **more
    )


def connection(a: str, b: str, what: str = "connect") -> dict[str, Any]:
    return {"type": "CX", "data": {what: [{"tagA": a, "tagB": b}]}}


def message(tag: str, type_name: str, value: Any, msg_id: str = "nil", key: str = "msg") -> dict[str, Any]:
    return {"type": "DM", "data": {"iTag": tag, "type": type_name, "msgID": msg_id, key: value}}
