"""Users, API keys and the audit log, as the HTTP API shows and takes them. Times are seconds since 1970."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rce.messages import Tag
from rce.roles import FREE, Scopes, UserRole

Password = Annotated[str, Meta(extra_json_schema={"minLength": 10, "maxLength": 1000})]  # its rules are the Master's
Label = Annotated[str, Meta(max_length=200)]
Expiry = Annotated[float, Meta(gt=0, lt=1e11)] | None


class Whoami(Struct, frozen=True):
    """Who the credentials are: `key` is the id of the API key, empty for a password.

    `rights` has `own`, `all` or `-` for each operation: what one may do to one's own things and those of all users.
    """

    user: str
    role: UserRole
    key: str = ""
    scopes: Scopes = FREE
    rights: dict[str, str] = {}


class KeyView(Struct, frozen=True):
    """An API key, without its secret. `used`: when it last let somebody in, to some seconds; no `expires`: never."""

    id: str
    user: str
    role: UserRole
    label: str
    created: float
    expires: float | None = None
    used: float | None = None
    scopes: Scopes = FREE


class NewKey(Struct, frozen=True, forbid_unknown_fields=True):
    """An API key to make. Without a role it has that of the credentials with which it is made."""

    role: UserRole | None = None
    label: Label = ""
    expires: Expiry = None
    scopes: Scopes = FREE


class MadeKey(Struct, frozen=True):
    """A key and its secret, which is shown this once."""

    secret: str
    key: KeyView


class UserView(Struct, frozen=True):
    """A user."""

    name: str
    role: UserRole
    created: float


class NewUser(Struct, frozen=True, forbid_unknown_fields=True):
    """A user to make."""

    name: Tag
    password: Password
    role: UserRole = "user"


class UserChanges(Struct, frozen=True, forbid_unknown_fields=True):
    """What is to be changed of a user."""

    role: UserRole


class NewPassword(Struct, frozen=True, forbid_unknown_fields=True):
    """A password to have from now on. The `old` one is needed, unless an administrator changes another user's."""

    new: Password
    old: str = ""


class UsageView(Struct, frozen=True):
    """What a user has of that which limits count, by the names of the limits; sizes are bytes."""

    environments: int
    cores: float
    total_memory: int
    total_bandwidth: int
    robots: int
    connections: int
    package_bytes: int


class AuditView(Struct, frozen=True):
    """Something that was done, or refused.

    `user` did it, with the API key `key`; empty: somebody who did not prove who they are. `action` is an operation as
    in `Whoami.rights`, or `login`. `object` begins with the user whose it is. `result` is ok, or the code of the error.
    """

    id: int
    time: float
    user: str
    key: str
    action: str
    object: str
    result: str
    door: str  # rest, websocket, live, map-service, offline
    address: str

    @property
    def origin(self) -> str:
        return f"{self.door} {self.address}".strip()
