"""Limits of users in the database: the platform's, and changes for single users."""

from __future__ import annotations

from typing import Any

import msgspec
import sqlalchemy as sa
from msgspec.structs import replace
from twisted.logger import Logger

from master.graph.limits import Policy, with_changes
from master.storage import tables as db
from master.storage.periodic import repeat
from master.storage.store import Store

PLATFORM = ""  # as user: the limits of everybody without own ones
REFRESH = 3.0  # seconds until changes by other processes (`rce user limits`) are seen
log = Logger()


class UserLimits:
    """Limits of all users. The Master gives `platform`; other programs use what the last Master stored."""

    def __init__(self, store: Store, platform: Policy | None = None) -> None:
        self._store = store
        self._given = platform
        self._platform = platform or Policy()
        self._own: dict[str, dict[str, Any]] = {}

    async def open(self) -> None:
        """Load all limits; call it once, before anything else."""
        if self._given is not None:
            await self._put(PLATFORM, msgspec.to_builtins(self._given))
        await self._load()

    async def follow(self) -> None:
        """Load changes by other processes periodically, until cancelled."""
        await repeat(REFRESH, self._load, "the limits of users could not be loaded")

    def of(self, user: str) -> Policy:
        """Return the limits of a user."""
        own = self._own.get(user)
        if own is None:
            return self._platform
        policy = with_changes(self._platform, own)
        return replace(policy, images=list(dict.fromkeys([*self._platform.images, *own.get("images", ())])))

    def own(self, user: str) -> dict[str, Any]:
        """Return what was changed for this user."""
        return dict(self._own.get(user, {}))

    async def change(self, user: str, changes: dict[str, Any]) -> None:
        """Change some limits of a user; None is no limit, and UNSET resets one to the platform's."""
        await self._load()
        own = {name: value for name, value in (self.own(user) | changes).items() if value is not msgspec.UNSET}
        await self._put(user, own)
        await self._load()

    async def _load(self) -> None:
        rows = await self._store.read(lambda connection: list(connection.execute(sa.select(db.limits))))
        found: dict[str, dict[str, Any]] = {row.user: msgspec.json.decode(row.value) for row in rows}
        platform = found.pop(PLATFORM, {})
        if self._given is None:
            self._platform = with_changes(Policy(), platform)
        self._own = found

    async def _put(self, user: str, value: dict[str, Any]) -> None:
        row = {"user": user, "value": msgspec.json.encode(value).decode()}

        def put(connection: sa.Connection) -> None:
            connection.execute(db.limits.delete().where(db.limits.c.user == user))
            if value:
                connection.execute(db.limits.insert(), row)

        await self._store.run(put)
