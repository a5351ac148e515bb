"""Steps of `provision install` that prepare services."""

from __future__ import annotations

import sqlite3
from contextlib import closing

import pytest

from provisioning import (
    services,
)
from provisioning.configuration import Installation
from provisioning.steps import Step
from provisioning.system import System
from tests.support.provisioning.systems import planned


def test_kernel_is_configured_once(debian: System) -> None:
    assert planned(debian)["kernel"] == "/etc/sysctl.d/60-rce.conf: net.core.rmem_max = 4194304"
    debian.path("/etc/sysctl.d").mkdir()
    debian.path(services.SYSCTL).touch()
    assert planned(debian)["kernel"] == ""


def test_administrator_is_made_once(debian: System) -> None:
    def todo() -> str:
        installation = Installation(("master",), "alpha", "10.0.0.1")
        step: Step = services.file_steps(debian, installation)[-1]
        return step.todo()

    assert todo()
    database = debian.path("/var/lib/rce/master/master.db")
    database.parent.mkdir(parents=True)
    with closing(sqlite3.connect(database)) as connection:
        assert todo()
        connection.execute("CREATE TABLE users (name TEXT)")
        connection.execute("INSERT INTO users VALUES ('admin')")
        connection.commit()
    assert todo() == ""


@pytest.mark.parametrize(("present", "outcome"), [("[]\n", "user admin, password in"), ('["admin"]\n', "kept")])
def test_administrator_in_postgresql_is_made_unless_there_are_users(
    debian: System, monkeypatch: pytest.MonkeyPatch, present: str, outcome: str
) -> None:
    ran: list[tuple[str, ...]] = []

    def run(*words: str, environment: dict[str, str], secret: str) -> str:
        assert environment == {"RCE_DATABASE": "postgresql+psycopg://rce:secret@db/rce"}
        ran.append(words)
        return present

    monkeypatch.setattr(services, "run", run)
    monkeypatch.setattr(System, "write", lambda *_: None)
    options = {"database": "postgresql+psycopg://rce:secret@db/rce"}
    step = services.file_steps(debian, Installation(("master",), "alpha", "10.0.0.1", options))[-1]
    assert step.todo() == "user admin, password in /etc/rce/admin-password, unless the database has users"
    assert step.action().startswith(outcome)
    assert not any("secret" in word for words in ran for word in words)
