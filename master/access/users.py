"""Users: names, roles, and authentication by password, API key or temporary key."""

from __future__ import annotations

import time
from collections.abc import Callable

import sqlalchemy as sa
from msgspec import Struct

from master.access.grants import KEY_PREFIX, LENT_PREFIX, Grants
from master.access.grants import digest as digest
from master.access.keys import Keys
from master.access.passwords import Passwords
from master.access.rights import check
from master.access.throttle import Throttle
from master.storage import tables as db
from master.storage.store import Store
from rce.api.roles import ASSIGNABLE_ROLES, Principal, UserRole
from rce.api.views import UserView
from rce.errors import AlreadyExists, InvalidRequest, NotFound, Unauthorized
from rce.net.certificates import MACHINE_DAYS
from rce.protocol.names import check_tag

DAY = 86_400.0


class Standing(Struct, frozen=True):
    """Snapshot of what credentials are valid for: the roles of all users, and the keys that have not expired."""

    roles: dict[str, UserRole]
    keys: set[str]

    def holds(self, principal: Principal) -> bool:
        """Return whether these credentials would still be accepted."""
        role = self.roles.get(principal.user)
        if (
            role is None
            or principal.role not in ASSIGNABLE_ROLES[role]
            or (principal.key and principal.key not in self.keys)
        ):
            return False
        return bool(principal.key) or principal.lent or principal.role == role


class Users:
    """Users in the database. `now` is the clock of the throttle and of verified passwords."""

    def __init__(self, store: Store, now: Callable[[], float] = time.monotonic) -> None:
        self.grants = Grants(store)
        self.keys = Keys(store)
        self.passwords = Passwords(now)
        self.throttle = Throttle(now)
        self._store = store
        self._changes: dict[str, int] = {}  # number of changes of password and role: a check that overlaps one fails

    # --- accounts -----------------------------------------------------------------------------------------------------

    async def add(self, name: str, password: str, role: UserRole = "user") -> UserView:
        """Add a user. The caller checks the strength of the password (`master.access.passwords.check_password`).

        Raises:
            AlreadyExists: There is a user of this name.
        """
        check_tag(name, "userID")
        user = UserView(name, role, time.time())
        row = {"name": name, "password": await self.passwords.hash(password), "role": role, "created": user.created}
        try:
            await self._store.run(lambda connection: connection.execute(db.users.insert(), row))
        except sa.exc.IntegrityError:
            raise AlreadyExists(f"user {name} exists already", field="userID") from None
        return user

    async def all(self) -> list[UserView]:
        """Return all users, sorted by name."""
        query = sa.select(db.users.c.name, db.users.c.role, db.users.c.created)
        rows = await self._store.read(lambda connection: list(connection.execute(query)))
        return sorted((UserView(row.name, row.role, row.created) for row in rows), key=lambda user: user.name)

    async def names(self) -> list[str]:
        """Return the names of all users, sorted."""
        return [user.name for user in await self.all()]

    async def get(self, name: str) -> UserView:
        """Return a user.

        Raises:
            NotFound: There is no such user.
        """
        query = sa.select(db.users.c.name, db.users.c.role, db.users.c.created).where(db.users.c.name == name)
        row = await self._store.read(lambda connection: connection.execute(query).first())
        if row is None:
            raise _unknown(name)
        return UserView(row.name, row.role, row.created)

    async def remove(self, name: str) -> None:
        """Remove a user with limits, keys and grants.

        Raises:
            NotFound: There is no such user.
            InvalidRequest: It is the last administrator.
        """

        def drop(connection: sa.Connection) -> int:
            _keep_an_admin(connection, name)
            connection.execute(db.limits.delete().where(db.limits.c.user == name))
            found = connection.execute(db.users.delete().where(db.users.c.name == name)).rowcount
            if found:
                _note_removal(connection, name)
            return found

        if not await self._store.run(drop):
            raise _unknown(name)
        self._changed(name)

    async def removals(self) -> dict[str, float]:
        """Return when users were removed, in seconds since 1970; each is later than those before."""
        query = sa.select(db.removed_users)
        return await self._store.read(lambda connection: {row.name: row.time for row in connection.execute(query)})

    async def change_role(self, name: str, role: UserRole) -> None:
        """Change a user's role, and remove keys and grants that go beyond the new role.

        Raises:
            NotFound: There is no such user.
            InvalidRequest: It is the last administrator.
        """

        def put(connection: sa.Connection) -> int:
            if role != "admin":
                _keep_an_admin(connection, name)
            keys = db.api_keys
            beyond = sa.and_(keys.c.user == name, keys.c.role.not_in(ASSIGNABLE_ROLES[role]))
            connection.execute(keys.delete().where(beyond))
            if "robot" not in ASSIGNABLE_ROLES[role]:
                connection.execute(db.grants.delete().where(db.grants.c.user == name))
            return connection.execute(db.users.update().where(db.users.c.name == name).values(role=role)).rowcount

        if not await self._store.run(put):
            raise _unknown(name)
        self._changed(name)

    async def change_password(self, name: str, password: str) -> None:
        """Change a user's password, and remove grants that were given with the old one.

        Raises:
            NotFound: There is no such user.
        """
        hashed = await self.passwords.hash(password)
        grants = db.grants.delete().where(db.grants.c.user == name, db.grants.c.key.is_(None))

        def put(connection: sa.Connection) -> int:
            connection.execute(grants)
            change = db.users.update().where(db.users.c.name == name).values(password=hashed)
            return connection.execute(change).rowcount

        if not await self._store.run(put):
            raise _unknown(name)
        self._changed(name)

    def _changed(self, name: str) -> None:
        self._changes[name] = self._changes.get(name, 0) + 1

    # --- authentication -----------------------------------------------------------------------------------------------

    async def check(self, name: str, secret: str, address: str = "") -> Principal:
        """Authenticate a user by `secret`: an API key, or the SHA-256 hex of the password.

        With an API key the name may be empty.

        Raises:
            Unauthorized: User or secret is wrong; it does not tell which.
            TooManyAttempts: Too many wrong passwords came before.
        """
        if secret.startswith(LENT_PREFIX):
            return await self.grants.check(name, secret)
        if secret.startswith(KEY_PREFIX):
            return await self.keys.check(name, secret)
        return await self.check_password(name, secret, address)

    async def check_password(self, name: str, secret: str, address: str) -> Principal:
        """Authenticate a user by the SHA-256 hex of the password; see `check`."""
        self.throttle.check(name, address)
        query = sa.select(db.users.c.password, db.users.c.role).where(db.users.c.name == name)
        change = self._changes.get(name)
        row = await self._store.read(lambda connection: connection.execute(query).first())
        if row is None or not self.passwords.was_verified(row.password, secret):
            async with self.passwords.slot():
                self.throttle.check(name, address)  # other attempts may have failed meanwhile
                good = await self.passwords.verify(row.password if row else None, secret)
        else:
            good = True
        if row is None or not good or self._changes.get(name) != change:
            self.throttle.wrong(name, address)
            raise Unauthorized("user or password is wrong")
        self.throttle.right(name, address)
        return Principal(name, row.role)

    async def standing(self) -> Standing:
        """Read what credentials are valid for now; other processes change the database, too."""
        keys = db.api_keys
        good = sa.or_(keys.c.expires.is_(None), keys.c.expires > time.time())

        def read(connection: sa.Connection) -> Standing:
            roles = {row.name: row.role for row in connection.execute(sa.select(db.users.c.name, db.users.c.role))}
            return Standing(roles, set(connection.scalars(sa.select(keys.c.id).where(good))))

        return await self._store.read(read)


def check_robot_login(principal: Principal, robot: str = "") -> None:
    """Check that somebody may connect as this robot.

    Raises:
        InvalidRequest: Administrators cannot be robots.
        Forbidden: The role or the key does not allow it.
    """
    if principal.role == "admin":
        raise InvalidRequest(
            "an administrator cannot connect as a robot: use a user of another role, or be a guest", field="userID"
        )
    check(principal, "robot.connect", principal.user, robot=robot)


def _unknown(name: str) -> NotFound:
    return NotFound(f"there is no user {name[:80]}", field="user")


def _keep_an_admin(connection: sa.Connection, name: str) -> None:
    """Raise InvalidRequest if `name` is the last administrator."""
    admins = list(connection.scalars(sa.select(db.users.c.name).where(db.users.c.role == "admin")))
    if admins == [name]:
        raise InvalidRequest(f"{name} is the last administrator: make another first", field="user")


def _note_removal(connection: sa.Connection, name: str) -> None:
    removed, now = db.removed_users, time.time()
    latest = connection.scalar(sa.select(sa.func.max(removed.c.time))) or 0.0
    forgotten = removed.c.time < now - MACHINE_DAYS * DAY  # a machine that was away since then cannot join any more
    connection.execute(removed.delete().where(sa.or_(removed.c.name == name, forgotten)))
    connection.execute(removed.insert(), {"name": name, "time": max(now, latest + 0.001)})
