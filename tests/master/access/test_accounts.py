"""`rce user` on the database of a Master on this machine."""

from __future__ import annotations

import io
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from master.access.accounts import parser, run
from master.access.audit import Audit, AuditFilter
from master.access.users import Users, digest
from master.storage.store import Store
from rce.api.roles import Scopes
from rce.errors import Forbidden, InvalidRequest, NotFound, RceError, Unauthorized

GOOD = "correct horse battery"
Command = Callable[..., Awaitable[None]]


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    """Run the command with a text on standard input."""

    async def do(*words: str, reads: str = "") -> None:
        monkeypatch.setattr(sys, "stdin", io.StringIO(reads + "\n"))
        await run(parser().parse_args(["--data-dir", str(tmp_path), *words]))

    return do


async def test_changes_are_audited(command: Command, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    await command("add", "ann", reads=GOOD)
    await command("key-add", "ann", "--robot", "r1", "--environment", "e1", "--label", "r1's")
    secret = capsys.readouterr().out.strip()
    await command("passwd", "ann", reads=GOOD + "!")
    await command("limits", "ann", "robots=2")
    await command("limits", "ann")
    await command("list")
    refused: list[tuple[type[RceError], tuple[str, ...], str]] = [
        (InvalidRequest, ("add", "bob"), "short"),
        (InvalidRequest, ("passwd", "ann"), "1234567890"),
        (NotFound, ("passwd", "bob"), GOOD),
        (Forbidden, ("key-add", "ann", "--role", "admin"), ""),
        (NotFound, ("key-revoke", "ann", "0123"), ""),
    ]
    for error, words, reads in refused:
        with pytest.raises(error):
            await command(*words, reads=reads)
    await command("remove", "ann")

    store = Store(f"sqlite:///{tmp_path / 'master.db'}")
    await store.open()
    entries = (await Audit(store).find(AuditFilter(), None, 100))[::-1]
    assert [(each.action, each.object, each.result) for each in entries] == [
        ("user.create", "ann", "ok"),
        ("key.create", "ann/r1's", "ok"),
        ("password.change", "ann", "ok"),
        ("limits.change", "ann", "ok"),
        ("user.create", "bob", "invalid_request"),
        ("password.change", "ann", "invalid_request"),
        ("password.change", "bob", "not_found"),
        ("key.create", "ann", "forbidden"),
        ("key.revoke", "ann/0123", "not_found"),
        ("user.remove", "ann", "ok"),
    ]
    assert {each.door for each in entries} == {"offline"}
    assert all(each.user.startswith("@") for each in entries)  # a user of this machine
    assert secret not in str(entries)
    assert await Users(store).names() == []
    await store.close()


async def test_passwords_and_tied_keys_are_created(
    command: Command, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    await command("add", "ann", reads=GOOD)
    await command("passwd", "ann", reads=GOOD + "!")
    await command("key-add", "ann", "--robot", "r1", "--environment", "e1")
    store = Store(f"sqlite:///{tmp_path / 'master.db'}")
    await store.open()
    users = Users(store)
    assert (await users.check("ann", digest(GOOD + "!"))).role == "user"
    with pytest.raises(Unauthorized):
        await users.check("ann", digest(GOOD))
    secret = capsys.readouterr().out.strip()
    assert (await users.check("ann", secret)).scopes == Scopes("r1", ["e1"])
    await store.close()


def test_data_directory_is_accepted_before_and_after_the_command() -> None:
    for line in ("--data-dir d add ann", "add --data-dir d ann", "add ann --data-dir d"):
        assert parser().parse_args(line.split()).data_dir == Path("d")
    assert parser().parse_args(["list", "--database", "sqlite://"]).database == "sqlite://"
