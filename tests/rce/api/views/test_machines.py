"""Invitations of machines."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rce.api.views.machines import NewInvitation


def test_machine_gets_both_roles_for_a_day_by_default() -> None:
    invitation = msgspec.convert({"name": "beta"}, NewInvitation)
    assert (invitation.roles, invitation.address, invitation.hours) == (["robot", "container"], "", 24)
    invitation.roles.append("robot")
    assert len(msgspec.convert({"name": "beta"}, NewInvitation).roles) == 2, "defaults are not shared"


@pytest.mark.parametrize("name", ["a", "beta-2", "B2", "x" * 63])
def test_names_of_machines_are_labels_of_host_names(name: str) -> None:
    assert msgspec.convert({"name": name}, NewInvitation).name == name


@pytest.mark.parametrize(
    "body",
    [
        {},
        *({"name": name} for name in ("", "-a", "a-", "a--b", "a.b", "a_b", "ä", "a b", "a\n", "x" * 64)),
        {"name": "a", "roles": []},
        {"name": "a", "roles": ["master"]},
        {"name": "a", "hours": 0},
        {"name": "a", "hours": 24 * 365 + 1},
        {"name": "a", "address": "x" * 256},
        {"name": "a", "token": "x"},
    ],
)
def test_wrong_invitation_is_refused(body: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(body, NewInvitation)
