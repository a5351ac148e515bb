"""Roles of users and API keys, and to what a key may be tied: what the Master and its clients know in common."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

UserRole = Literal["admin", "operator", "user", "viewer", "robot"]
MOST_ENVIRONMENTS = 100

WITHIN: dict[UserRole, frozenset[UserRole]] = {
    "admin": frozenset({"admin", "operator", "user", "viewer", "robot"}),
    "operator": frozenset({"operator", "user", "viewer", "robot"}),
    "user": frozenset({"user", "viewer", "robot"}),
    "viewer": frozenset({"viewer"}),
    "robot": frozenset({"robot"}),
}
"""The roles that a key may have, by that of its user: never one that may do what the user may not."""


class Scopes(Struct, frozen=True, omit_defaults=True, forbid_unknown_fields=True):
    """What narrows an API key further than its role. Ties are for keys of the role robot.

    `robot` is the only robotID that it connects as and touches; `environments` are the only ones that exist for it. One
    that is for `metrics` reads those and nothing else.
    """

    robot: str = ""
    environments: Annotated[list[str], Meta(max_length=MOST_ENVIRONMENTS)] = []
    metrics: bool = False

    @property
    def tied(self) -> bool:
        return bool(self.robot or self.environments)


FREE = Scopes()


class Principal(Struct, frozen=True, omit_defaults=True):
    """Who somebody has proved to be; `key` is the id of the API key, empty for a password.

    A service that acts for a user with a lent key has the id of the key by which the right was given.
    """

    user: str
    role: UserRole
    key: str = ""
    lent: bool = False  # by the user to a service that acts for them
    scopes: Scopes = FREE
