"""Secrets of users: who has which, and which environments get them."""

from __future__ import annotations

import pytest

from master.graph import secrets, sessions
from rce.control.calls.endpoints import PutSecrets, Secret, Sync
from rce.errors import InvalidRequest, LimitExceeded, NotFound
from rce.protocol import messages as m
from tests.support.master.fleet import calls, furnished

WITH = m.CreateContainer("safe", m.ContainerData(secrets={"database": "PASSWORD", "other": ""}))


def test_environment_gets_the_secrets_of_its_user_before_its_nodes() -> None:
    fleet = furnished()
    for name in ("database", "other"):
        secrets.put(fleet.state, "ann", name, "sealed", 0)
    fleet.do("ann", WITH)
    plan = fleet.join("ann/safe", "environment", host="h2")
    first, second = calls(plan, "ann/safe")[:2]
    assert first == PutSecrets({"database": Secret("PASSWORD"), "other": Secret("")})
    assert isinstance(second, Sync)
    assert not any(isinstance(call, PutSecrets) for call in calls(fleet.join("ann/brain", "environment", host="h2")))


def test_other_users_secrets_do_not_exist() -> None:
    fleet = furnished()
    secrets.put(fleet.state, "ann", "database", "sealed", 0)
    secrets.put(fleet.state, "ann", "other", "sealed", 0)
    with pytest.raises(NotFound):
        fleet.do("bob", WITH)
    assert fleet.state.environments.count("bob") == 0


def test_variables_of_the_platform_are_refused() -> None:
    fleet = furnished()
    secrets.put(fleet.state, "ann", "database", "sealed", 0)
    with pytest.raises(InvalidRequest):
        fleet.do("ann", m.CreateContainer("safe", m.ContainerData(secrets={"database": "LD_PRELOAD"})))


def test_number_is_limited_and_removal_is_complete(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = furnished()
    monkeypatch.setattr(secrets, "MOST", 1)
    secrets.put(fleet.state, "ann", "a", "sealed", 0)
    secrets.put(fleet.state, "ann", "a", "again", 0)
    with pytest.raises(LimitExceeded):
        secrets.put(fleet.state, "ann", "b", "sealed", 0)
    secrets.remove(fleet.state, "ann", "a")
    with pytest.raises(NotFound):
        secrets.remove(fleet.state, "ann", "a")


def test_removed_users_leave_none() -> None:
    fleet = furnished()
    for user in ("ann", "bob"):
        secrets.put(fleet.state, user, "a", "sealed", 0)
    sessions.user_gone(fleet.state, "ann")
    secrets.drop_strays(fleet.state, {"ann"})
    assert len(fleet.state.secrets) == 0
