"""`rce machine` on the database of a Master on this machine."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from master.access import invitations
from master.access.audit import Audit, AuditFilter
from master.access.invitations import main, parser, run
from master.access.join_tokens import JoinTokens
from master.storage.store import Store
from rce.api.joining import parse_join_code
from rce.errors import InvalidRequest, NotFound, RceError, Unauthorized
from rce.net.certificates import Authority, fingerprint
from rce.net.tls import CA

AUTHORITY = Authority.make("tests")
Command = Callable[..., Awaitable[None]]


def configure(directory: Path, machines: str = "tcp:8081") -> Path:
    """Write the settings of a Master and return their file."""
    (directory / CA).write_text(AUTHORITY.certificate)
    file = directory / "master.toml"
    file.write_text(
        f'data_dir = "{directory}"\ntls = "{directory}"\nmachines = "{machines}"\naddress = "alpha"\n', "utf-8"
    )
    return file


@pytest.fixture
def config(tmp_path: Path) -> Path:
    return configure(tmp_path)


@pytest.fixture
def command(config: Path) -> Command:
    async def do(*words: str) -> None:
        await run(parser().parse_args(["--config", str(config), *words]))

    return do


async def test_printed_join_code_is_an_invitation(
    command: Command, store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    await command("add", "beta", "--role", "robot", "--address", "10.0.0.2", "--hours", "2")
    code = parse_join_code(capsys.readouterr().out)
    assert (code.url, code.authority) == ("https://alpha:8081/", fingerprint(AUTHORITY.certificate))
    assert (code.invitation.roles, code.invitation.address) == (["robot"], "10.0.0.2")
    assert await JoinTokens(store).redeem("beta", code.invitation.digest, "key")


async def test_machine_has_all_roles_by_default(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    await command("add", "beta")
    assert parse_join_code(capsys.readouterr().out).invitation.roles == ["robot", "container"]


async def test_removed_machine_has_no_credentials(
    command: Command, store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    await command("add", "beta")
    invitation = parse_join_code(capsys.readouterr().out).invitation
    tokens = JoinTokens(store)
    await tokens.allow("beta", "container", "t1")
    await tokens.allow("beta-robot", "robot", "t2")
    credentials = [
        ("beta", "container", await tokens.admit("beta", "container", "t1")),
        ("beta-robot", "robot", await tokens.admit("beta-robot", "robot", "t2")),
    ]
    await command("remove", "beta")
    for name, role, credential in credentials:
        with pytest.raises(Unauthorized):
            await tokens.admit(name, role, credential)
    assert not await tokens.redeem("beta", invitation.digest, "key")


async def test_removal_of_an_unknown_machine_fails(command: Command) -> None:
    with pytest.raises(NotFound, match="no machine 'btea'"):
        await command("remove", "btea")


async def test_machines_that_have_joined_are_listed(
    command: Command, store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    tokens = JoinTokens(store)
    for name in ("m2", "m1"):
        await tokens.allow(name, "container", name)
        await tokens.admit(name, "container", name)
    await command("list")
    await command("list", "--json")
    assert capsys.readouterr().out == 'm1\nm2\n["m1","m2"]\n'


async def test_changes_and_refusals_are_audited(
    command: Command, store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    await command("add", "beta")
    code = capsys.readouterr().out.strip()
    for words in (["no name"], ["beta", "--hours", "0"], ["b", "--hours", "inf"]):
        with pytest.raises(InvalidRequest):
            await command("add", *words)
    await command("remove", "beta")
    await command("list")
    entries = (await Audit(store).find(AuditFilter(), None, 100))[::-1]
    assert [(each.action, each.object, each.result) for each in entries] == [
        ("machine.add", "beta", "ok"),
        ("machine.add", "no name", "invalid_request"),
        ("machine.add", "beta", "invalid_request"),
        ("machine.add", "b", "invalid_request"),
        ("machine.remove", "beta", "ok"),
    ]
    assert {each.door for each in entries} == {"offline"}
    assert all(each.user.startswith("@") for each in entries)  # a user of this machine
    assert code not in str(entries)


async def test_master_that_machines_cannot_join_invites_none(tmp_path: Path) -> None:
    config = configure(tmp_path, machines="")
    with pytest.raises(InvalidRequest, match="lacks the settings `machines` or `tls`"):
        await run(parser().parse_args(["--config", str(config), "add", "beta"]))


def test_settings_are_accepted_before_and_after_the_command() -> None:
    for line in ("--config c add beta", "add --config c beta", "add beta --config c"):
        assert parser().parse_args(line.split()).config == Path("c")
    assert parser().parse_args(["list"]).config == invitations.CONFIG


@pytest.mark.parametrize("error", [Unauthorized("no"), PermissionError("no")])
def test_failure_is_one_line_and_a_status(
    error: RceError | OSError, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(words: object) -> None:
        raise error

    monkeypatch.setattr(invitations, "run", fail)
    assert main(["list"]) == 1
    assert capsys.readouterr().err == "rce machine: no\n"
