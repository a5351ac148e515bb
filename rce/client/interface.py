"""What the robot's ends of topics and services have in common."""

from __future__ import annotations

import asyncio
from typing import Protocol

from rce.client.connection import Connection, Message
from rce.errors import NotConnected, RceError, Unavailable

CONNECT_TIMEOUT = 10.0


class Owner(Protocol):
    """What an interface needs of its robot."""

    @property
    def connection(self) -> Connection | None: ...

    async def remove_interface(self, endpoint: str, tag: str) -> None: ...

    @property
    def name(self) -> str: ...


class Interface:
    """One interface of a robot. `connected` tells whether it has a peer, at a platform that can be reached."""

    def __init__(self, owner: Owner, tag: str, type_name: str) -> None:
        self.tag = tag
        self.type_name = type_name
        self._owner = owner
        self._status = False
        self._open = asyncio.Event()
        self._ended: RceError | None = None

    @property
    def connected(self) -> bool:
        return self._open.is_set()

    async def wait_connected(self, timeout: float = CONNECT_TIMEOUT) -> None:  # noqa: ASYNC109  # the error names it
        """Wait for a peer. Raises NotConnected after `timeout` seconds."""
        try:
            if not self._open.is_set():
                async with asyncio.timeout(timeout):
                    await self._open.wait()
        except TimeoutError:
            raise NotConnected(
                f"{self._owner.name}/{self.tag} has had no peer for {timeout:g} s: connect it to an interface that "
                "exists; robot.events() has the errors of both"
            ) from None
        if self._ended is not None:
            raise self._ended

    async def close(self) -> None:
        """Remove the interface and its connections."""
        await self._owner.remove_interface(self._owner.name, self.tag)

    # What the robot tells its interfaces.

    def status(self, connected: bool) -> None:
        self._status = connected
        self._changed()

    def lost(self) -> None:
        self._open.clear()

    def back(self, status: bool) -> None:
        self._status = status
        self._changed()

    def received(self, message: Message) -> None:
        """A DM of this interface; raises ConversionError."""

    def failed(self, error: RceError, msg_id: str) -> bool:
        """Whether the call of this id was one of this interface's, which then raises the error."""
        return False

    def ended(self, error: RceError | None) -> None:
        """Nothing more will come."""
        self._ended = error or Unavailable(f"{self._owner.name}/{self.tag} has been closed")
        self._open.set()

    def _changed(self) -> None:
        if self._status and self._owner.connection is not None:
            self._open.set()
        else:
            self._open.clear()

    def _connection(self) -> Connection | None:
        return self._owner.connection if self._open.is_set() and self._ended is None else None
