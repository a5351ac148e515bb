"""`python -m master`: errors at the start are one sentence each."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from twisted.logger import LogEvent, formatEvent, globalLogPublisher

from master.__main__ import create_first_users
from master.access.users import Users
from master.storage.store import Store
from rce.process.lock import lock_directory


def refusal(directory: Path, *more: str) -> str:
    words = [sys.executable, "-P", "-m", "master", f"--data-dir={directory}", "--http=tcp:0:interface=127.0.0.1"]
    ended = subprocess.run(
        [*words, "--control=tcp:0:interface=127.0.0.1", *more], capture_output=True, text=True, timeout=60
    )
    event = json.loads(ended.stderr)
    assert (ended.returncode, event["level"], "traceback" in event) == (1, "error", False)
    return str(event["message"])


def test_two_masters_do_not_share_a_directory(tmp_path: Path) -> None:
    with lock_directory(tmp_path, "Master"):
        assert refusal(tmp_path).startswith(f"another Master uses {tmp_path}: stop it, or")


def test_directory_that_cannot_be_created_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert refusal(tmp_path / "file" / "master") == f"{tmp_path}/file/master: not a directory"


def test_damaged_database_is_named_with_a_remedy(tmp_path: Path) -> None:
    (tmp_path / "master.db").write_bytes(b"no database" * 1000)
    told = refusal(tmp_path)
    assert f"{tmp_path}/master.db" in told
    assert "file is not a database; check that" in told
    assert "sqlalche.me" not in told


def test_malformed_endpoint_is_shown_with_an_example(tmp_path: Path) -> None:
    assert refusal(tmp_path, "--http=9000").startswith("'9000' is no Twisted server endpoint such as tcp:9000 or")
    assert not (tmp_path / "master.db").exists()  # no password was created that nobody has seen


async def test_development_users_are_warned_of_without_dev(tmp_path: Path) -> None:
    store = Store(f"sqlite:///{tmp_path / 'master.db'}")
    await store.open()
    users = Users(store)
    seen: list[str] = []

    def observe(event: LogEvent) -> None:
        seen.append(formatEvent(event))

    globalLogPublisher.addObserver(observe)  # type: ignore[arg-type]  # mypy does not know zope's interfaces
    try:
        await create_first_users(users, dev=True)
        await users.change_password("testUser", "another password")
        seen.clear()
        await create_first_users(users, dev=False)
    finally:
        globalLogPublisher.removeObserver(observe)  # type: ignore[arg-type]
        await store.close()
    assert [line for line in seen if "password of development mode" in line and "user admin" in line]
    assert not [line for line in seen if "testUser" in line]
