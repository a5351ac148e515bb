"""Execution of commands from API requests, on the same path through the Master as those of robots."""

from __future__ import annotations

import asyncio
from typing import Any
from urllib.parse import quote

from master.access import rights
from master.api.principals import principal_of
from master.api.request import Answer, Call
from master.api.router import PREFIX
from master.service import Master
from rce.errors import NotFound
from rce.protocol.messages import Command


class Commands:
    """Executes commands. A command that has begun is not cancelled when its client disconnects."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._tasks: set[asyncio.Task[Any]] = set()

    async def execute(self, call: Call, user: str, command: Command, robot: str = "") -> str:
        """Execute a command for a user, by default the caller, and return that user's name once it is done.

        `robot` is the robotID of the user's robot that the command is about, as if it had given it.

        Raises:
            Forbidden: The caller may not do this, or not for that user.
            NotFound: There is no such user.
        """
        owner = user or call.user
        call.audit.operation, call.audit.owner = rights.COMMANDS[type(command)], owner
        rights.check_command(principal_of(call), self._master.state, owner, command)
        if owner != call.user and owner not in await self._master.users.names():
            raise NotFound(f"there is no user {owner[:80]}", field="user")
        task = asyncio.ensure_future(self._master.commands.execute(owner, command, robot=robot))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        await asyncio.shield(task)
        return owner


def created(call: Call, owner: str, view: Any, *path: str) -> Answer:
    """Return the answer for a new resource, with its address in Location."""
    place = "/".join([PREFIX, *(quote(part, safe="") for part in path)])
    return Answer(view, 201, {"location": place if owner == call.user else f"{place}?user={quote(owner)}"})
