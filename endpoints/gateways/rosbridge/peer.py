"""The client as its topics, services and actions see it."""

from __future__ import annotations

import asyncio
from typing import Protocol

from msgspec import UNSET

from endpoints.gateways.rosbridge.operations import Id
from rce.errors import RceError


class Peer(Protocol):
    """A client of rosbridge."""

    def report(self, error: RceError, id: Id = UNSET) -> None:
        """Count an error of the client and, if it asked for statuses, send it."""

    def pause_until(self, ready: asyncio.Future[None]) -> None:
        """Read nothing more from the client until a future is done."""

    async def type_of_topic(self, topic: str) -> str:
        """Return the type of a topic of the environment; raise NotFound if it has none."""
