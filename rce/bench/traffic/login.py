"""Logins of the benchmark's robots."""

from __future__ import annotations

import asyncio
from collections.abc import Set
from urllib.parse import urlencode

from msgspec import Struct

from rce.api.client import ApiClient
from rce.api.views import RobotView
from rce.client.address import Address

END_TIMEOUT, END_INTERVAL = 60.0, 0.1  # seconds until the sessions of robots that closed their sockets have ended


class Login(Struct, frozen=True):
    """Entry of the platform, and user and key of the robots."""

    url: str
    user: str
    key: str

    async def locate(self) -> str:
        """Return the address of a Robot endpoint."""
        return await Address(self.url, self.user, "crowd", key=self.key).locate()

    def query(self, robot: str, features: str = "") -> str:
        """Return the query of a robot's login."""
        return urlencode({"userID": self.user, "robotID": robot, "key": self.key, "features": features})


async def until_logged_out(api: ApiClient, robots: Set[str]) -> None:
    """Wait until the sessions of robots have ended, which takes time that the next phase would seem to need.

    Raises:
        TimeoutError: They have not ended for a minute.
    """
    async with asyncio.timeout(END_TIMEOUT):
        while await asyncio.to_thread(_has_session, api, robots):  # noqa: ASYNC110  # there is no event for it
            await asyncio.sleep(END_INTERVAL)


def _has_session(api: ApiClient, robots: Set[str]) -> bool:
    return any(each.robotID in robots for each in api.items(RobotView, "robots"))
