"""Client of the live feed."""

from __future__ import annotations

import asyncio
import json
from typing import Any

from websockets.asyncio.client import ClientConnection, connect

from tests.support.master.served import Served


class Watch:
    """A watcher, with the state that it has received."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.seen: dict[str, dict[str, Any]] = {}
        self.messages = 0

    async def take(self) -> dict[str, Any]:
        message: dict[str, Any] = json.loads(await asyncio.wait_for(self.socket.recv(), 20))
        self.messages += 1
        assert message["seq"] == self.messages
        if message.get("snapshot"):
            self.seen = {}
        for kind, views in message.get("put", {}).items():
            self.seen.setdefault(kind, {}).update(views)
        for kind, keys in message.get("drop", {}).items():
            for key in keys:
                del self.seen[kind][key]
        return message

    async def until(self, *path: str, value: Any) -> None:
        def now() -> Any:
            found: Any = self.seen
            for part in path:
                found = found.get(part, {})
            return found

        while now() != value:
            await self.take()


async def watch(served: Served, by: str, **greeting: Any) -> Watch:
    secret, _ = await served.master.users.keys.add(by, "operator" if by == "olga" else "user")
    socket = await connect(f"ws://127.0.0.1:{served.port}/api/v1/live")
    await socket.send(json.dumps({"key": secret} | greeting))
    watcher = Watch(socket)
    assert (await watcher.take())["snapshot"]
    return watcher
