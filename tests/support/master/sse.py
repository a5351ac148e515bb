"""Client of server-sent events."""

from __future__ import annotations

import asyncio
import contextlib
import json
from typing import Any

from rce.api.roles import Scopes
from tests.support.master.served import Served


class Follower:
    """An open stream of server-sent events."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer

    async def next(self) -> Any:
        """Return the data of the next event, after checking its id and name; None at the end."""
        fields: dict[str, str] = {}
        while (line := await asyncio.wait_for(self._reader.readline(), 20)) != b"0\r\n":  # last chunk
            name, colon, value = line.decode().strip().partition(": ")
            if colon:
                fields[name] = value
            if "data" in fields:
                data = json.loads(fields["data"])
                assert fields.get("event", "") in ("error", data.get("type", ""))
                assert fields.get("id", "") == data.get("id", data.get("next", ""))
                return data
        return None

    async def read_some(self) -> bytes:
        """Return bytes as they come; none at the end."""
        return await self._reader.read(65_536)

    async def types(self, count: int) -> list[str]:
        return [(await self.next())["type"] for _ in range(count)]

    async def close(self) -> None:
        self._writer.close()
        with contextlib.suppress(ConnectionError):
            await self._writer.wait_closed()


async def follow(served: Served, path: str, user: str, scopes: Scopes | None = None, **headers: str) -> Follower:
    role: Any = "robot" if scopes else {"olga": "operator", "ann": "user", "bob": "user"}[user]
    secret, _ = await served.master.users.keys.add(user, role, scopes=scopes or Scopes())
    reader, writer = await asyncio.open_connection("127.0.0.1", served.port)
    lines = [f"GET /api/v1{path} HTTP/1.1", "Host: x", f"Authorization: Bearer {secret}"]
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    writer.write(("\r\n".join(lines) + "\r\n\r\n").encode())
    assert b"200" in await asyncio.wait_for(reader.readline(), 20)
    while await asyncio.wait_for(reader.readline(), 20) != b"\r\n":
        pass
    return Follower(reader, writer)
