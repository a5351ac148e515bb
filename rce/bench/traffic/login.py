"""Logins of the benchmark's robots."""

from __future__ import annotations

from urllib.parse import urlencode

from msgspec import Struct

from rce.client.address import Address


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
