"""Guard: closes sockets, feeds and streams whose credentials were revoked or expired.

Changes of users and keys go through the guard. Changes that another process makes in the database (`rce user`), and
keys that expire, are found by a periodic check.
"""

from __future__ import annotations

from collections.abc import Callable

from twisted.logger import Logger

from master.access.users import Users
from master.graph import reconcile, sessions
from master.graph.effects import Plan, Send
from master.graph.records import Ref
from master.graph.state import State
from master.storage.periodic import repeat
from rce.api.roles import ASSIGNABLE_ROLES, Principal, UserRole
from rce.api.views import KeyView
from rce.control.calls.services import InvalidateAuthentication

REFRESH = 3.0  # seconds between checks
log = Logger()
IsInvalid = Callable[[Principal], bool]
Close = Callable[[str], None]


class Guard:
    """Knows what is open by which credentials. `apply` runs the plans for robots that are disconnected."""

    def __init__(self, users: Users, state: State, apply: Callable[[Plan], None]) -> None:
        self._users = users
        self._state = state
        self._apply = apply
        self._open: dict[object, tuple[Principal, Close]] = {}

    # --- open connections ---------------------------------------------------------------------------------------------

    def hold(self, principal: Principal, close: Close) -> Callable[[], None]:
        """Register a connection of `principal`; `close` is called with the reason when its credentials are invalid.

        Returns:
            A function to call when the connection has ended by itself.
        """
        mark = object()
        self._open[mark] = principal, close

        def release() -> None:
            self._open.pop(mark, None)

        return release

    def cut(self, invalid: IsInvalid, reason: str) -> None:
        """Close everything that is open by credentials that are `invalid`."""
        plan: Plan = []
        for robot in self._state.robots:
            if invalid(robot.by):
                log.info("robot {robot} is disconnected: {reason}", robot=robot.name, reason=reason)
                plan += sessions.robot_dismissed(self._state, robot.name, reason)
        if plan:
            self._apply(plan)
        for mark, (principal, close) in list(self._open.items()):
            if invalid(principal):
                self._open.pop(mark, None)
                close(reason)

    async def follow(self) -> None:
        """Check all credentials periodically, until cancelled."""
        await repeat(REFRESH, self.check_all, "credentials could not be checked")

    async def check_all(self) -> None:
        """Close what is open by invalid credentials, pass on who was removed, and store when keys were used."""
        await self._users.keys.note_use()
        await self.read_removals()
        await self._cut_invalid("the credentials are not valid any more")

    async def _cut_invalid(self, reason: str) -> None:
        standing = await self._users.standing()
        self.cut(lambda principal: not standing.holds(principal), reason)

    def _invalidate_caches(self, user: str) -> None:
        """Tell services, which cache authentications for a while."""
        services = [each.name for each in self._state.processes.by("service") if each.name in self._state.joined]
        self._apply([[Send(name, InvalidateAuthentication(user), Ref("authentication", user))] for name in services])

    # --- changes of credentials ---------------------------------------------------------------------------------------

    async def revoke_key(self, user: str, key: str) -> None:
        """Revoke a key with those that were made with it, and close what is open by them.

        Raises:
            NotFound: The user has no such key.
        """
        users = await self._users.keys.revoke(user, key)
        await self._cut_invalid("the API key was revoked")
        for each in users:
            self._invalidate_caches(each)

    async def rotate_key(self, user: str, key: str, by: str = "") -> tuple[str, KeyView]:
        """Rotate a key and close what is open by its old secret; grants that were given with the key stay.

        Raises:
            NotFound: The user has no such key.
            Forbidden: It was not made with the key `by`.
        """
        fresh = await self._users.keys.rotate(user, key, by)
        self.cut(lambda principal: principal.key == key and not principal.lent, "the API key has a new secret")
        self._invalidate_caches(user)
        return fresh

    async def change_password(self, user: str, password: str) -> None:
        """Change a password and close what is open by the old one; keys stay valid.

        Raises:
            NotFound: There is no such user.
        """
        await self._users.change_password(user, password)
        self.cut(lambda principal: principal.user == user and not principal.key, "the password was changed")
        self._invalidate_caches(user)

    async def change_role(self, user: str, role: UserRole) -> None:
        """Change a role and close what is open beyond the new one.

        Raises:
            NotFound: There is no such user.
            InvalidRequest: It is the last administrator.
        """
        before = (await self._users.get(user)).role
        await self._users.change_role(user, role)

        def invalid(principal: Principal) -> bool:
            by_password = not principal.key and not principal.lent and role != before
            return principal.user == user and (by_password or principal.role not in ASSIGNABLE_ROLES[role])

        self.cut(invalid, f"the user's role is {role} now")
        await self._cut_invalid("the API key was revoked")  # keys of others that were made with one of these
        self._invalidate_caches(user)

    async def remove_user(self, user: str) -> None:
        """Remove a user with everything that is theirs.

        Raises:
            NotFound: There is no such user.
            InvalidRequest: It is the last administrator.
        """
        await self._users.remove(user)
        self.cut(lambda principal: principal.user == user, "the user was removed")
        await self._cut_invalid("the API key was revoked")  # keys of others that were made with one of this user
        self._invalidate_caches(user)
        self._apply(sessions.user_gone(self._state, user))
        await self.read_removals()

    async def read_removals(self) -> None:
        """Tell the processes that keep things of users who was removed, also by a command beside the Master."""
        removed = await self._users.removals()
        if removed != self._state.removed_users:
            self._state.removed_users = removed
            self._apply(reconcile.announce_removed_users(self._state))
