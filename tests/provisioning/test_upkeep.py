"""`provision upgrade` and `provision uninstall`."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from provisioning import (
    upkeep,
)
from provisioning.system import System


def test_upgrade_backs_up_the_database(installed: System) -> None:
    database = installed.path("/var/lib/rce/master/master.db")
    assert upkeep._backup_step(installed).todo() == ""
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("CREATE TABLE users (name TEXT)")
        connection.commit()
    installed.path("/opt/rce/current").symlink_to("releases/0.1.0-abc")
    step = upkeep._backup_step(installed)
    copy = Path(step.action())
    assert copy.name == "master-0.1.0-abc.db"
    assert copy.stat().st_mode & 0o777 == 0o600
    with closing(sqlite3.connect(copy)) as connection:
        assert connection.execute("SELECT name FROM sqlite_master").fetchall() == [("users",)]


def uninstall(installed: System, purge: bool, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    monkeypatch.setattr(upkeep, "docker_answers", lambda: False)
    steps = upkeep.uninstall_steps(installed, purge)
    plan = {step.name: step.todo() for step in steps}
    for step in steps:
        if step.name in ("units", "kernel", "code", "settings and data"):
            step.action()
    return plan


def test_uninstall_keeps_settings_and_data(installed: System, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = uninstall(installed, False, monkeypatch)
    names = ("master", "robot", "container", "map-service", "knowledge-service")
    assert plan["services"] == "stop " + " ".join(f"rce-{name}.service" for name in names)
    assert installed.path("/etc/rce/master.toml").exists()
    assert installed.path("/var/lib/rce/master").exists()
    assert not installed.path("/opt/rce").exists()
    assert list(installed.path("/etc/systemd/system").iterdir()) == []


def test_purge_removes_everything(installed: System, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = uninstall(installed, True, monkeypatch)
    assert plan["user"] == "remove rce"
    assert [path for path in installed.root.rglob("*rce*") if path != installed.root] == []
    again = upkeep.uninstall_steps(installed, True)
    assert {step.name for step in again if step.todo()} <= {"processes", "user"}
