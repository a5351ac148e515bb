"""Users: who they are, what role they have, and by what they prove themselves."""

from __future__ import annotations

import time
from collections.abc import Callable

import sqlalchemy as sa
from msgspec import Struct

from master import store as db
from master.grants import KEY_PREFIX, LENT_PREFIX, Grants
from master.grants import digest as digest
from master.keys import Keys
from master.passwords import Passwords
from master.rights import check
from master.throttle import Throttle
from rce.errors import AlreadyExists, InvalidRequest, NotFound, Unauthorized
from rce.names import check_tag
from rce.roles import WITHIN, Principal, UserRole
from rce.views import UserView


class Standing(Struct, frozen=True):
    """What credentials are good for just now: the roles of all users, and the keys that are not over."""

    roles: dict[str, UserRole]
    keys: set[str]

    def holds(self, principal: Principal) -> bool:
        """Whether who came in with these credentials could come in again."""
        role = self.roles.get(principal.user)
        if role is None or principal.role not in WITHIN[role] or (principal.key and principal.key not in self.keys):
            return False
        return bool(principal.key) or principal.lent or principal.role == role


class Users:
    """People and programs that may use the platform. `now` is for the throttle."""

    def __init__(self, store: db.Store, now: Callable[[], float] = time.monotonic) -> None:
        self.grants = Grants(store)
        self.keys = Keys(store)
        self.passwords = Passwords()
        self.throttle = Throttle(now)
        self._store = store
        self._changes: dict[str, int] = {}  # of passwords and roles: a check that was under way is void

    # --- who there is -------------------------------------------------------------------------------------------------

    async def add(self, name: str, password: str, role: UserRole = "user") -> UserView:
        """Whether the password is good enough is for who asks; see `master.passwords.check_password`."""
        check_tag(name, "userID")
        user = UserView(name, role, time.time())
        row = {"name": name, "password": await self.passwords.hash(password), "role": role, "created": user.created}
        try:
            await self._store.run(lambda connection: connection.execute(db.users.insert(), row))
        except sa.exc.IntegrityError:
            raise AlreadyExists(f"user {name} exists already", field="userID") from None
        return user

    async def all(self) -> list[UserView]:
        """By their names."""
        query = sa.select(db.users.c.name, db.users.c.role, db.users.c.created)
        rows = await self._store.run(lambda connection: list(connection.execute(query)))
        return sorted((UserView(row.name, row.role, row.created) for row in rows), key=lambda user: user.name)

    async def names(self) -> list[str]:
        return [user.name for user in await self.all()]

    async def get(self, name: str) -> UserView:
        """NotFound."""
        query = sa.select(db.users.c.name, db.users.c.role, db.users.c.created).where(db.users.c.name == name)
        row = await self._store.run(lambda connection: connection.execute(query).first())
        if row is None:
            raise _unknown(name)
        return UserView(row.name, row.role, row.created)

    async def remove(self, name: str) -> None:
        """With limits, keys and grants. NotFound; InvalidRequest if it is the last administrator."""

        def drop(connection: sa.Connection) -> int:
            _keep_an_admin(connection, name)
            connection.execute(db.limits.delete().where(db.limits.c.user == name))
            return connection.execute(db.users.delete().where(db.users.c.name == name)).rowcount

        if not await self._store.run(drop):
            raise _unknown(name)
        self._changed(name)

    async def change_role(self, name: str, role: UserRole) -> None:
        """Keys and grants that go beyond the new role are gone with it. NotFound, InvalidRequest."""

        def put(connection: sa.Connection) -> int:
            if role != "admin":
                _keep_an_admin(connection, name)
            keys = db.api_keys
            beyond = sa.and_(keys.c.user == name, keys.c.role.not_in(WITHIN[role]))
            connection.execute(keys.delete().where(beyond))
            if "robot" not in WITHIN[role]:
                connection.execute(db.grants.delete().where(db.grants.c.user == name))
            return connection.execute(db.users.update().where(db.users.c.name == name).values(role=role)).rowcount

        if not await self._store.run(put):
            raise _unknown(name)
        self._changed(name)

    async def change_password(self, name: str, password: str) -> None:
        """What was lent on the word of the old one is void. NotFound."""
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

    # --- who somebody is ----------------------------------------------------------------------------------------------

    async def check(self, name: str, secret: str, address: str = "") -> Principal:
        """`secret` is an API key or the SHA-256 hex of the password. Unauthorized says no more; TooManyAttempts.

        With an API key the name may be empty: the key knows its user.
        """
        if secret.startswith(LENT_PREFIX):
            return await self.grants.check(name, secret)
        if secret.startswith(KEY_PREFIX):
            return await self.keys.check(name, secret)
        return await self.check_password(name, secret, address)

    async def check_password(self, name: str, secret: str, address: str) -> Principal:
        """As `check`, when it must be the password."""
        self.throttle.check(name, address)
        async with self.passwords.turn():
            self.throttle.check(name, address)  # others may have guessed meanwhile
            change = self._changes.get(name)
            query = sa.select(db.users.c.password, db.users.c.role).where(db.users.c.name == name)
            row = await self._store.run(lambda connection: connection.execute(query).first())
            good = await self.passwords.verify(row.password if row else None, secret)
            if row is None or not good or self._changes.get(name) != change:
                self.throttle.wrong(name, address)
                raise Unauthorized("user or password is wrong")
        self.throttle.right(name, address)
        return Principal(name, row.role)

    async def standing(self) -> Standing:
        """Of all credentials, as the database has them: other processes change it too."""
        keys = db.api_keys
        good = sa.or_(keys.c.expires.is_(None), keys.c.expires > time.time())

        def read(connection: sa.Connection) -> Standing:
            roles = {row.name: row.role for row in connection.execute(sa.select(db.users.c.name, db.users.c.role))}
            return Standing(roles, set(connection.scalars(sa.select(keys.c.id).where(good))))

        return await self._store.run(read)


def must_drive(principal: Principal, robot: str = "") -> None:
    """Refuse those who may not connect as this robot."""
    if principal.role == "admin":
        raise InvalidRequest(
            "an administrator cannot connect as a robot: use a user of another role, or be a guest", field="userID"
        )
    check(principal, "robot.connect", principal.user, robot=robot)


def _unknown(name: str) -> NotFound:
    return NotFound(f"there is no user {name[:80]}", field="user")


def _keep_an_admin(connection: sa.Connection, name: str) -> None:
    """InvalidRequest if nobody would be left to administer the platform."""
    admins = list(connection.scalars(sa.select(db.users.c.name).where(db.users.c.role == "admin")))
    if admins == [name]:
        raise InvalidRequest(f"{name} is the last administrator: make another first", field="user")
