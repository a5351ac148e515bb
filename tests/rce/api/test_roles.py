"""Roles and scopes."""

from __future__ import annotations

from typing import get_args

import pytest

from rce.api.roles import ASSIGNABLE_ROLES, UNRESTRICTED, Scopes, UserRole


@pytest.mark.parametrize("role", get_args(UserRole))
def test_assignable_roles_are_reflexive_and_transitive(role: UserRole) -> None:
    assert role in ASSIGNABLE_ROLES[role]
    for other in ASSIGNABLE_ROLES[role]:
        assert ASSIGNABLE_ROLES[other] <= ASSIGNABLE_ROLES[role]


def test_only_robot_and_environments_tie_a_key() -> None:
    assert not UNRESTRICTED.tied
    assert not Scopes(metrics=True).tied
    assert Scopes(robot="r2d2").tied
    assert Scopes(environments=["brain"]).tied


@pytest.mark.parametrize(
    ("own", "other", "within"),
    [
        (Scopes(), Scopes(), True),
        (Scopes("r1"), Scopes(), True),
        (Scopes(), Scopes("r1"), False),
        (Scopes("r1"), Scopes("r2"), False),
        (Scopes(environments=["a"]), Scopes(environments=["a", "b"]), True),
        (Scopes(environments=["a", "c"]), Scopes(environments=["a", "b"]), False),
        (Scopes(), Scopes(environments=["a"]), False),
        (Scopes(metrics=True), Scopes(), True),
        (Scopes(), Scopes(metrics=True), False),
    ],
)
def test_scopes_are_compared(own: Scopes, other: Scopes, within: bool) -> None:
    assert own.within(other) is within
