"""Common base of a robot's publishers, subscribers, service clients and service providers."""

from __future__ import annotations

import asyncio
from typing import Protocol

from rce.client.connection import Connection, Message
from rce.errors import NotConnected, RceError, Unavailable

CONNECT_TIMEOUT = 10.0


class Owner(Protocol):
    """The part of `Robot` that its interfaces use."""

    @property
    def connection(self) -> Connection | None:
        """The open connection, or None while offline."""

    async def remove_interface(self, endpoint: str, tag: str) -> None:
        """Remove an interface and its connections."""

    @property
    def name(self) -> str:
        """The robotID."""


class Interface:
    """One interface of a robot.

    Attributes:
        tag: Name of the interface, unique within the robot.
        type_name: ROS message or service type, for example `std_msgs/String`.
    """

    def __init__(self, owner: Owner, tag: str, type_name: str) -> None:
        self.tag = tag
        self.type_name = type_name
        self._owner = owner
        self._status = False
        self._met = False  # it has had a peer
        self._open = asyncio.Event()
        self._ended: RceError | None = None

    @property
    def connected(self) -> bool:
        """True while the robot is online and the interface has a peer that is online too."""
        return self._open.is_set() and self._ended is None

    @property
    def was_connected(self) -> bool:
        """True once the interface has had a peer, which may be gone again."""
        return self._met

    async def wait_connected(self, timeout: float = CONNECT_TIMEOUT) -> None:  # noqa: ASYNC109  # the error names it
        """Wait until the interface has a peer; returns at once if it has one.

        While the robot is offline this keeps waiting, and a reconnection within `timeout` satisfies it.

        Args:
            timeout: Seconds to wait.

        Raises:
            NotConnected: There was no peer for `timeout` seconds.
            RceError: The interface or the robot was closed (`Unavailable`), or the platform refused the robot.
        """
        try:
            if not self._open.is_set():
                async with asyncio.timeout(timeout):
                    await self._open.wait()
        except TimeoutError:
            raise NotConnected(
                f"{self._owner.name}/{self.tag} has had no peer for {timeout:g} s: connect it to an existing "
                "interface, and look at robot.events() for the errors of both"
            ) from None
        if self._ended is not None:
            raise self._ended

    async def close(self) -> None:
        """Remove the interface and its connections from the platform.

        Pending reads and calls end at once. While the robot is offline, the removal is sent after the reconnection.

        Raises:
            TimedOut: The platform did not answer within the robot's command timeout.
            RceError: The platform refused the removal, for example `NotFound` if the interface was removed already.
        """
        await self._owner.remove_interface(self._owner.name, self.tag)

    # Called by the Dispatcher only.

    def _set_status(self, connected: bool) -> None:
        """Handle the platform's report about the peer of this interface."""
        self._status = connected
        self._update()

    def _disconnected(self) -> None:
        """Handle the loss of the robot's socket."""
        self._open.clear()

    def _receive(self, message: Message) -> None:
        """Handle a message for this interface; raises ConversionError."""

    def _fail_call(self, error: RceError, msg_id: str) -> bool:
        """Fail the pending call with this msgID; returns False if it is not one of this interface."""
        return False

    def _refused(self, error: RceError) -> bool:
        """Handle an error about a message of this interface; return True if nobody else need know it."""
        return False

    def _end(self, error: RceError | None) -> None:
        """Finish for good: nothing is sent or received any more."""
        self._ended = error or Unavailable(f"{self._owner.name}/{self.tag} has been closed")
        self._open.set()

    def _update(self) -> None:
        if self._status and self._owner.connection is not None:
            self._met = True
            self._open.set()
        else:
            self._open.clear()

    def _connection(self) -> Connection | None:
        return self._owner.connection if self._open.is_set() and self._ended is None else None
