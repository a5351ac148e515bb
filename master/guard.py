"""What is open by somebody's credentials is closed when these are void: sockets of robots, feeds, follows.

Changes of users and keys come through here, so that nothing stays open; what another process changed in the database
(`rce user`), and keys that expire, are seen at the next look round.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import sqlalchemy as sa
from twisted.logger import Logger

from master import presence
from master.effects import Plan, Send
from master.records import State
from master.users import Users
from rce.calls.services import ForgetProofs
from rce.roles import WITHIN, Principal, UserRole
from rce.views import KeyView

REFRESH = 3.0  # seconds from one look round to the next
log = Logger()
Void = Callable[[Principal], bool]
Close = Callable[[str], None]


class Guard:
    """`apply` takes what is to be done about robots that were cut."""

    def __init__(self, users: Users, state: State, apply: Callable[[Plan], None]) -> None:
        self._users = users
        self._state = state
        self._apply = apply
        self._open: dict[object, tuple[Principal, Close]] = {}

    # --- what is open -------------------------------------------------------------------------------------------------

    def hold(self, principal: Principal, close: Close) -> Callable[[], None]:
        """Something is open for `principal`: `close` is called with the reason when it may not be any more.

        Returns what is to be called when it has ended by itself.
        """
        mark = object()
        self._open[mark] = principal, close

        def release() -> None:
            self._open.pop(mark, None)

        return release

    def cut(self, void: Void, reason: str) -> None:
        """Close all that is open by credentials that are `void`."""
        plan: Plan = []
        for robot in self._state.robots:
            if void(robot.by):
                log.info("robot {robot} is cut off: {reason}", robot=robot.name, reason=reason)
                plan += presence.robot_dismissed(self._state, robot.name, reason)
        if plan:
            self._apply(plan)
        for mark, (principal, close) in list(self._open.items()):
            if void(principal):
                self._open.pop(mark, None)
                close(reason)

    async def follow(self) -> None:
        """Look round now and then, until cancelled."""
        while True:
            await asyncio.sleep(REFRESH)
            try:
                await self.look_round()
            except sa.exc.SQLAlchemyError as error:
                log.warn("credentials could not be looked at: {error}", error=str(error))

    async def look_round(self) -> None:
        """Cut off whoever could not come in again, and write when keys were used."""
        await self._users.keys.note_use()
        standing = await self._users.standing()
        self.cut(lambda principal: not standing.holds(principal), "the credentials are not good any more")

    def _ask_anew(self, user: str) -> None:
        """Services remember for a while who somebody is."""
        services = [each.name for each in self._state.processes.by("service") if each.name in self._state.joined]
        self._apply([[Send(name, ForgetProofs(user), "proofs")] for name in services])

    # --- what makes credentials void ----------------------------------------------------------------------------------

    async def revoke_key(self, user: str, key: str) -> None:
        """NotFound."""
        await self._users.keys.revoke(user, key)
        self.cut(lambda principal: principal.key == key, "the API key was revoked")
        self._ask_anew(user)

    async def rotate_key(self, user: str, key: str) -> tuple[str, KeyView]:
        """What services do for the user by this key goes on. NotFound."""
        fresh = await self._users.keys.rotate(user, key)
        self.cut(lambda principal: principal.key == key and not principal.lent, "the API key has a new secret")
        self._ask_anew(user)
        return fresh

    async def change_password(self, user: str, password: str) -> None:
        """Keys stay as they are. NotFound."""
        await self._users.change_password(user, password)
        self.cut(lambda principal: principal.user == user and not principal.key, "the password was changed")
        self._ask_anew(user)

    async def change_role(self, user: str, role: UserRole) -> None:
        """NotFound, InvalidRequest."""
        before = (await self._users.get(user)).role
        await self._users.change_role(user, role)

        def void(principal: Principal) -> bool:
            by_password = not principal.key and not principal.lent and role != before
            return principal.user == user and (by_password or principal.role not in WITHIN[role])

        self.cut(void, f"the user's role is {role} now")
        self._ask_anew(user)

    async def remove_user(self, user: str) -> None:
        """With all that is theirs. NotFound, InvalidRequest."""
        await self._users.remove(user)
        self.cut(lambda principal: principal.user == user, "the user was removed")
        self._ask_anew(user)
        self._apply(presence.user_gone(self._state, user))
