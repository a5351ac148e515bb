"""`rce user` on the database of a Master on this machine."""

from __future__ import annotations

import asyncio
import io
import json
import os
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from master.access.accounts import main, parser, run
from master.access.audit import Audit, AuditFilter
from master.access.user_limits import UserLimits
from master.access.users import Users, digest
from master.graph.limits import Policy
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


async def test_changes_are_audited(command: Command, store: Store, capsys: pytest.CaptureFixture[str]) -> None:
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


async def test_passwords_and_tied_keys_are_created(
    command: Command, store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    await command("add", "ann", reads=GOOD)
    await command("passwd", "ann", reads=GOOD + "!")
    await command("key-add", "ann", "--robot", "r1", "--environment", "e1")
    users = Users(store)
    assert (await users.check("ann", digest(GOOD + "!"))).role == "user"
    with pytest.raises(Unauthorized):
        await users.check("ann", digest(GOOD))
    secret = capsys.readouterr().out.strip()
    assert (await users.check("ann", secret)).scopes == Scopes("r1", ["e1"])


def test_data_directory_is_accepted_before_and_after_the_command() -> None:
    for line in ("--data-dir d add ann", "add --data-dir d ann", "add ann --data-dir d"):
        assert parser().parse_args(line.split()).data_dir == Path("d")
    assert parser().parse_args(["list", "--database", "sqlite://"]).database == "sqlite://"


async def test_limits_are_shown_and_changed(
    command: Command, store: Store, users: Users, capsys: pytest.CaptureFixture[str]
) -> None:
    await UserLimits(store, Policy(size=4)).open()
    await command("limits", "ann", "memory=2GiB", "images=mine/*")
    assert ["memory", "2147483648", "own"] in [line.split() for line in capsys.readouterr().out.splitlines()]
    await command("limits", "ann", "--json")
    shown = json.loads(capsys.readouterr().out)
    assert (shown["size"], shown["images"]) == (4, ["mine/*"])
    for changes, images in (
        (["images+=users/ann/tools", "images+=mine/*"], ["mine/*", "users/ann/tools"]),
        (["images=a/b", "images+=c/d"], ["a/b", "c/d"]),
        (["images=", "images+=e/f"], ["e/f"]),
        (["images="], []),
    ):
        await command("limits", "ann", *changes, "--json")
        assert json.loads(capsys.readouterr().out)["images"] == images
    with pytest.raises(NotFound, match="no user nobody"):
        await command("limits", "nobody")
    with pytest.raises(InvalidRequest, match="memory"):
        await command("limits", "ann", "memory=x")


async def test_keys_and_users_are_listed(command: Command, users: Users, capsys: pytest.CaptureFixture[str]) -> None:
    _, endless = await users.keys.add("ann", "viewer", "dashboard")
    await users.keys.add("ann", "robot", "r1", 1_900_000_000.0)
    await command("key-list", "ann")
    first, second = capsys.readouterr().out.splitlines()
    assert first.split() == [endless.id, "viewer", "never", "expires", "dashboard"]
    assert second.split()[1:] == ["robot", "2030-03-17", "r1"]
    await command("key-list", "ann", "--json")
    assert [key["label"] for key in json.loads(capsys.readouterr().out)] == ["dashboard", "r1"]
    await command("list")
    await command("list", "--json")
    assert capsys.readouterr().out == 'ann\n["ann"]\n'


async def test_key_expires_after_its_days(command: Command, users: Users) -> None:
    now = time.time()
    await command("key-add", "ann", "--days", "0.5")
    await command("key-add", "ann")
    brief, endless = await users.keys.of("ann")
    assert brief.expires is not None
    assert now + 43_200 <= brief.expires <= time.time() + 43_200
    assert endless.expires is None


@pytest.mark.parametrize("days", ["0", "-1", "nan", "inf", "1e9", "soon"])
def test_days_of_a_key_are_a_positive_number(days: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parser().parse_args(["key-add", "ann", f"--days={days}"])
    assert "--days" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("typed", "reason"), [((GOOD, GOOD + "!"), "the passwords differ"), ((), "no password was given")]
)
async def test_password_at_a_terminal_is_typed_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, typed: tuple[str, ...], reason: str
) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    answers = iter(typed)

    def ask(prompt: str) -> str:
        try:
            return next(answers)
        except StopIteration:
            raise EOFError from None  # Ctrl-D

    monkeypatch.setattr(sys, "stdin", Terminal())
    monkeypatch.setattr("getpass.getpass", ask)
    with pytest.raises(RceError, match=reason):
        await run(parser().parse_args(["--data-dir", str(tmp_path), "add", "--create", "ann"]))


async def test_missing_data_directory_is_not_created(tmp_path: Path) -> None:
    with pytest.raises(RceError, match="there is no directory"):
        await run(parser().parse_args(["--data-dir", str(tmp_path / "none"), "list"]))
    assert not (tmp_path / "none").exists()


async def test_database_is_made_only_on_request(tmp_path: Path, command: Command) -> None:
    for words in (("list",), ("add", "ann")):
        with pytest.raises(NotFound, match="no database of a Master"):
            await command(*words, reads=GOOD)
    assert os.listdir(tmp_path) == []
    await command("add", "ann", "--create", reads=GOOD)
    await command("list")


def test_failure_is_one_line_and_a_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(GOOD))
    asyncio.run(run(parser().parse_args(["--data-dir", str(tmp_path), "add", "--create", "ann"])))
    monkeypatch.setattr(sys, "argv", ["rce user", "--data-dir", str(tmp_path), "limits", "nobody"])
    assert main() == 1
    assert capsys.readouterr().err == "rce user: there is no user nobody\n"
