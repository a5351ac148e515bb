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
