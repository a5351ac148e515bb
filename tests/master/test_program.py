"""`python -m master`: errors at the start are one sentence each."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from twisted.logger import LogEvent, formatEvent, globalLogPublisher

from master.__main__ import _parse_token, _pool, create_first_users, loopback_only
from master.access.users import Users, digest
from master.storage.store import Store
from rce.errors import InvalidRequest
from rce.process.lock import lock_directory

pytestmark = pytest.mark.slow  # starts the program many times


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


@pytest.fixture
async def nobody(tmp_path: Path) -> AsyncIterator[Users]:
    """The users of a new database."""
    store = Store(f"sqlite:///{tmp_path / 'master.db'}")
    await store.open()
    yield Users(store)
    await store.close()


async def test_development_users_are_warned_of_without_dev(nobody: Users) -> None:
    seen: list[str] = []

    def observe(event: LogEvent) -> None:
        seen.append(formatEvent(event))

    globalLogPublisher.addObserver(observe)  # type: ignore[arg-type]  # mypy does not know zope's interfaces
    try:
        await create_first_users(nobody, dev=True)
        await nobody.change_password("testUser", "another password")
        seen.clear()
        await create_first_users(nobody, dev=False)
    finally:
        globalLogPublisher.removeObserver(observe)  # type: ignore[arg-type]
    assert [line for line in seen if "password of development mode" in line and "user admin" in line]
    assert not [line for line in seen if "testUser" in line]


async def test_first_administrator_gets_a_password_that_is_printed_once(
    nobody: Users, capsys: pytest.CaptureFixture[str]
) -> None:
    await create_first_users(nobody, dev=False)
    _, name, _, password, _ = capsys.readouterr().out.split("'")
    assert (await nobody.check(name, digest(password))).role == "admin"
    await create_first_users(nobody, dev=False)
    assert capsys.readouterr().out == ""
    assert await nobody.names() == ["admin"]


async def test_development_users_are_created_in_an_empty_database_only(nobody: Users) -> None:
    await nobody.add("ann", "secret", "admin")
    await create_first_users(nobody, dev=True)
    assert await nobody.names() == ["ann"]


@pytest.mark.parametrize(
    ("description", "served"),
    [
        ("tcp:9000", "tcp:9000:interface=127.0.0.1"),
        ("tcp:9000:interface=localhost", "tcp:9000:interface=localhost"),
        ("tcp:9000:interface=127.0.0.1:backlog=5", "tcp:9000:interface=127.0.0.1:backlog=5"),
    ],
)
def test_development_mode_serves_loopback(description: str, served: str) -> None:
    assert loopback_only(description) == served


@pytest.mark.parametrize("address", ["0.0.0.0", "127.0.0.1.example", "192.168.0.2"])
def test_development_mode_with_another_address_is_refused(address: str) -> None:
    with pytest.raises(InvalidRequest, match="--dev serves this machine only"):
        loopback_only(f"tcp:9000:interface={address}")


@pytest.mark.parametrize("entry", ["west", "robot:west", "robot::t", "robot:west:", "environment:a/b:t", "robot:w:t:t"])
def test_malformed_join_token_is_refused(entry: str) -> None:
    with pytest.raises(InvalidRequest, match="setting tokens"):
        _parse_token(entry)


@pytest.mark.parametrize("role", ["robot", "container", "service"])
def test_join_token_is_for_a_process_of_its_role(role: str) -> None:
    assert _parse_token(f"{role}:west:t") == (role, "west", "t")


@pytest.mark.parametrize("pool", ["10.0.0.0/25", "10.0.0.1/8", "nonsense", "fd00::/8"])
def test_network_that_is_no_pool_for_groups_is_refused(pool: str) -> None:
    with pytest.raises(InvalidRequest) as raised:
        _pool(pool)
    assert raised.value.field == "group_pool"


def test_pool_for_groups_has_room_for_one_at_least() -> None:
    assert _pool("10.0.0.0/24").prefixlen == 24
