"""Robots that send and receive raw frames, and raw handshakes."""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections.abc import Callable
from typing import Any

from websockets.asyncio.client import ClientConnection, connect

WAIT = 60.0  # seconds until a test that waits for something gives up
USER = "testUser"
PASSWORD = hashlib.sha256(USER.encode()).hexdigest()
Json = dict[str, Any]
WEBSOCKET_HEADERS = (
    "Host: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
)
LOGIN_QUERY = f"userID={USER}&robotID=r&password={PASSWORD}"


class Robot:
    """Raw WebSocket client of one robot."""

    def __init__(self, tag: str, socket: ClientConnection) -> None:
        self.tag = tag
        self.socket = socket

    async def send(self, *frames: Json | str | bytes) -> None:
        for frame in frames:
            await self.socket.send(json.dumps(frame) if isinstance(frame, dict) else frame)

    async def receive(self) -> Any:
        """Return the next frame: decoded JSON, or the bytes of a binary one."""
        async with asyncio.timeout(WAIT):
            frame = await self.socket.recv()
        return json.loads(frame) if isinstance(frame, str) else frame

    async def receive_all(self, count: int) -> list[Any]:
        return [await self.receive() for _ in range(count)]

    async def until(self, wanted: Callable[[Any], bool]) -> list[Any]:
        """Return all frames up to the first that is wanted."""
        frames = [await self.receive()]
        while not wanted(frames[-1]):
            frames.append(await self.receive())
        return frames

    async def expect_silence(self) -> None:
        """Check that no frame has come: an invalid frame is sent, and its ER must be the next frame."""
        await self.send("?")
        answer = await self.receive()
        assert answer["type"] == "ER", answer
        assert "not a JSON object" in answer["data"], answer

    async def closed(self) -> tuple[int, str]:
        """Wait until the server closes the socket; return its code and reason."""
        async with asyncio.timeout(WAIT):
            while True:
                try:
                    await self.socket.recv()
                except Exception:  # noqa: BLE001  # each way to close has its own class
                    break
        return self.socket.close_code or 0, self.socket.close_reason or ""

    # commands

    async def add(self, tag: str, kind: str, type: str = "std_msgs/String", of: str = "", **more: object) -> None:
        item = {"endpointTag": of or self.tag, "interfaceTag": tag, "interfaceType": kind, "className": type, **more}
        await self.send({"type": "CN", "data": {"addInterfaces": [item]}})

    async def connect(self, one: str, other: str) -> None:
        await self.send({"type": "CX", "data": {"connect": [{"tagA": one, "tagB": other}]}})

    async def data(
        self, tag: str, msg: object, type: str = "std_msgs/String", msg_id: str = "nil", **more: Any
    ) -> None:
        frame = {"type": "DM", "data": {"iTag": tag, "type": type, "msgID": msg_id, "msg": msg}, **more}
        await self.send(frame)


async def eventually(condition: Callable[[], bool]) -> None:
    """Wait for a condition for which there is no event."""
    async with asyncio.timeout(WAIT):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.005)


def status(tag: str, on: bool) -> Json:
    return {"type": "ST", "data": {"topic": "iu", "iTag": tag, "status": on}}


def dm(tag: str, msg: object, type: str = "std_msgs/String", msg_id: str = "nil") -> Json:
    return {"type": "DM", "data": {"iTag": tag, "type": type, "msgID": msg_id, "msg": msg}}


class RobotClients:
    """Opens robots' sockets at a port, and closes those that are left."""

    def __init__(self, port: int) -> None:
        self.port = port
        self._open: list[ClientConnection] = []

    async def robot(self, tag: str, features: str = "", **more: Any) -> Robot:
        secret = f"key={more.pop('key')}" if "key" in more else f"password={PASSWORD}"
        query = f"userID={more.pop('user', USER)}&robotID={tag}&{secret}"
        query += f"&features={features}" if features else ""
        query += "".join(f"&{key}={more.pop(key)}" for key in ("resume", "compress") if key in more)
        timeouts = {"open_timeout": WAIT, "close_timeout": 1, "ping_interval": None}
        more = {"max_size": None, "compression": None} | timeouts | more
        socket = await connect(f"ws://127.0.0.1:{self.port}/?{query}", **more)
        self._open.append(socket)
        return Robot(tag, socket)

    async def close(self) -> None:
        await asyncio.gather(*(socket.close() for socket in self._open))
