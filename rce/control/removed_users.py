"""Removed users, in a process that keeps things of users, such as a service."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

from twisted.logger import Logger

from rce.control.calls.joining import SetRemovedUsers
from rce.control.connection import Handlers

log = Logger()


class RemovedUsers:
    """Removes what a process keeps of users that were removed, also of those that were while it was away.

    The time of the last removal that it has carried out is in a file. It is only compared with other times of the
    Master.
    """

    def __init__(self, file: Path, forget: Callable[[str], Awaitable[None]]) -> None:
        """Prepare; `forget` removes all that is kept of a user now, not what comes later."""
        self._file = file
        self._forget = forget
        self._lock = asyncio.Lock()

    def add_to(self, handlers: Handlers) -> None:
        """Answer the Master's call with these handlers."""
        handlers.do(SetRemovedUsers, self.update)

    async def update(self, call: SetRemovedUsers) -> None:
        """Forget the users that were removed since the last time."""
        async with self._lock:
            seen = float(self._file.read_text()) if self._file.exists() else 0.0
            fresh = sorted((when, user) for user, when in call.users.items() if when > seen)
            for when, user in fresh:
                log.info("removing what is kept of user {user}, who was removed", user=user)
                await self._forget(user)
                draft = self._file.with_name(self._file.name + ".new")
                draft.write_text(repr(when))
                draft.replace(self._file)
