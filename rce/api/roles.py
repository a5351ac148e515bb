"""Roles of users and API keys, and scopes of API keys."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

UserRole = Literal["admin", "operator", "user", "viewer", "robot"]
MAX_ENVIRONMENTS = 100

ASSIGNABLE_ROLES: dict[UserRole, frozenset[UserRole]] = {
    "admin": frozenset({"admin", "operator", "user", "viewer", "robot"}),
    "operator": frozenset({"operator", "user", "viewer", "robot"}),
    "user": frozenset({"user", "viewer", "robot"}),
    "viewer": frozenset({"viewer"}),
    "robot": frozenset({"robot"}),
}
"""Roles that an API key may have, by the role of its user: none that permits more than the user's own."""


class Scopes(Struct, frozen=True, omit_defaults=True, forbid_unknown_fields=True):
    """Restrictions of an API key beyond its role. Only keys of the role robot can be tied.

    `robot` is the only robotID that the key may connect as and access; `environments` are the only environments that it
    may access. A key for `metrics` may read those and nothing else.
    """

    robot: str = ""
    environments: Annotated[list[str], Meta(max_length=MAX_ENVIRONMENTS)] = []
    metrics: bool = False

    @property
    def tied(self) -> bool:
        """True if the key is restricted to a robot or to environments."""
        return bool(self.robot or self.environments)

    def within(self, other: Scopes) -> bool:
        """Return whether these scopes permit no more than the other ones."""
        environments = not other.environments or (
            bool(self.environments) and {*self.environments} <= {*other.environments}
        )
        return other.robot in ("", self.robot) and environments and self.metrics >= other.metrics


UNRESTRICTED = Scopes()


class Principal(Struct, frozen=True, omit_defaults=True):
    """Authenticated identity; `key` is the id of the API key, empty for a password.

    For a service that acts for a user with a lent key, it is the id of the key with which the user granted this.
    """

    user: str
    role: UserRole
    key: str = ""
    lent: bool = False  # the key was lent to a service that acts for the user
    scopes: Scopes = UNRESTRICTED
