"""Types of users, API keys and the audit log. Times are seconds since 1970."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rce.api.roles import UNRESTRICTED, Scopes, UserRole
from rce.protocol.names import Tag

Password = Annotated[str, Meta(extra_json_schema={"minLength": 10, "maxLength": 1000})]  # the Master enforces the rules
Label = Annotated[str, Meta(max_length=200)]
Expiry = Annotated[float, Meta(gt=0, lt=1e11)] | None


class Whoami(Struct, frozen=True):
    """Identity of the caller; `key` is the id of the API key, empty for a password.

    `rights` maps each operation to `own` (allowed on the user's own resources), `all` (on those of all users) or `-`.
    """

    user: str
    role: UserRole
    key: str = ""
    scopes: Scopes = UNRESTRICTED
    rights: dict[str, str] = {}


class NewSecret(Struct, frozen=True, forbid_unknown_fields=True):
    """Secret: a text, at most 32,768 characters."""

    name: Tag
    value: Annotated[str, Meta(min_length=1, max_length=32_768, pattern=r"^[^\x00]*$")]

    def __repr__(self) -> str:
        return f"NewSecret({self.name!r})"  # values do not get into logs


class SecretView(Struct, frozen=True):
    """Secret without its value."""

    name: str
    created: float


class KeyView(Struct, frozen=True):
    """API key without its secret.

    `used` is the time of its last use, to a few seconds. Without `expires` the key is permanent. `parent` is the key
    with which it was made and with which it ends; empty if it was made with a password.
    """

    id: str
    user: str
    role: UserRole
    label: str
    created: float
    expires: float | None = None
    used: float | None = None
    scopes: Scopes = UNRESTRICTED
    parent: str = ""


class NewKey(Struct, frozen=True, forbid_unknown_fields=True):
    """API key to create. Without a role it gets that of the credentials with which it is created.

    A key that is made with another key ends with that one; without `expires` it expires when that one does.
    """

    role: UserRole | None = None
    label: Label = ""
    expires: Expiry = None
    scopes: Scopes = UNRESTRICTED


class CreatedKey(Struct, frozen=True):
    """New API key with its secret, which is shown only once."""

    secret: str
    key: KeyView


class UserView(Struct, frozen=True):
    """User of the platform."""

    name: str
    role: UserRole
    created: float


class NewUser(Struct, frozen=True, forbid_unknown_fields=True):
    """User to create."""

    name: Tag
    password: Password
    role: UserRole = "user"


class UserChanges(Struct, frozen=True, forbid_unknown_fields=True):
    """Changes of a user."""

    role: UserRole


class NewPassword(Struct, frozen=True, forbid_unknown_fields=True):
    """New password. The `old` one is required, except when an administrator changes another user's."""

    new: Password
    old: str = ""


class UsageView(Struct, frozen=True):
    """Current usage of a user, by the names of the limits; sizes are bytes."""

    environments: int
    cores: float
    total_memory: int
    total_bandwidth: int
    robots: int
    connections: int
    package_bytes: int


class AuditView(Struct, frozen=True):
    """Entry of the audit log: an action that was executed or refused.

    `user` acted with the API key `key`; empty if the caller was not authenticated. `action` is an operation as in
    `Whoami.rights`, or `login`. `object` begins with the user to whom it belongs. `result` is `ok` or the error code.
    """

    id: int
    time: float
    user: str
    key: str
    action: str
    object: str
    result: str
    door: str  # rest, websocket, live, map-service, knowledge-service, offline
    address: str

    @property
    def origin(self) -> str:
        """Interface and address through which the action came."""
        return f"{self.door} {self.address}".strip()
