"""Users' commands by HTTP: the same that robots send, by the same way through the Master."""

from __future__ import annotations

import asyncio
from typing import Any
from urllib.parse import quote

from master import rights
from master.api.acting import principal
from master.api.calls import Answer, Call
from master.api.router import PREFIX
from master.service import Master
from rce.errors import NotFound
from rce.messages import Command


class Commands:
    """Carries them out. One that began is not broken off when who asked goes away."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._tasks: set[asyncio.Task[Any]] = set()

    async def execute(self, call: Call, user: str, command: Command) -> str:
        """For `user`, or for who asks if that is empty; returns once it is carried out. Whose it is."""
        owner = user or call.user
        call.trail.operation, call.trail.owner = rights.COMMANDS[type(command)], owner
        rights.check_command(principal(call), self._master.state, owner, command)
        if owner != call.user and owner not in await self._master.users.names():
            raise NotFound(f"there is no user {owner[:80]}", field="user")
        task = asyncio.ensure_future(self._master.execute(owner, command))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        await asyncio.shield(task)
        return owner


def created(call: Call, owner: str, view: Any, *path: str) -> Answer:
    """What was made, and where it is."""
    place = "/".join([PREFIX, *(quote(part, safe="") for part in path)])
    return Answer(view, 201, {"location": place if owner == call.user else f"{place}?user={quote(owner)}"})
