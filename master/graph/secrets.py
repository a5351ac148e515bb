"""Users' secrets, sealed: texts that nodes get as files and variables, and that nobody is shown again."""

from __future__ import annotations

from collections.abc import Mapping

from master.graph.records import Secret, user_of
from master.graph.state import State
from rce.errors import LimitExceeded, NotFound
from rce.protocol.names import check_tag

MOST = 100  # of one user


def put(state: State, user: str, name: str, sealed: str, now: float) -> Secret:
    """Set a secret; environments that run get it with their next life.

    Raises:
        LimitExceeded: The user has too many.
    """
    secret = Secret(f"{user}/{check_tag(name, 'name')}", sealed, now)
    if secret.key not in state.secrets and state.secrets.count(user) >= MOST:
        raise LimitExceeded(f"you have {MOST} secrets: remove some", limit=MOST)
    state.secrets.put(secret)
    return secret


def remove(state: State, user: str, name: str) -> None:
    """Remove a secret; environments that run keep what they got.

    Raises:
        NotFound: There is none of this name.
    """
    if state.secrets.drop(f"{user}/{name}") is None:
        raise NotFound(f"you have no secret {name[:80]!r}", field="name")


def check(state: State, user: str, wanted: Mapping[str, str]) -> None:
    """Check that a user has the secrets that an environment wants.

    Raises:
        NotFound: One does not exist.
    """
    for name in wanted:
        if f"{user}/{name}" not in state.secrets:
            raise NotFound(
                f"there is no secret {name[:80]!r}: `rce secret set` makes it", field="containerData.secrets"
            )


def variables(wanted: Mapping[str, str]) -> dict[str, str]:
    """Return the variables that an environment wants for its secrets, without their values."""
    return {variable: "" for variable in wanted.values() if variable}


def drop_strays(state: State, users: set[str]) -> None:
    """Remove the secrets of removed users: a later user of the same name must not inherit them."""
    for secret in state.secrets:
        if user_of(secret.name) not in users:
            state.secrets.drop(secret.name)
