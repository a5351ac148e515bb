"""`login`, `logout`, `context`, `whoami`, and the console's own commands."""

from __future__ import annotations

import asyncio
import getpass
import io
import json
import stat
import sys
import time
from pathlib import Path

import pytest

from rce.api.client import ApiClient
from rce.api.views import Whoami
from rce.cli import contexts, table
from rce.cli.commands.login import _context_name, read_password
from rce.cli.contexts import Context, Contexts
from rce.cli.execute import FAILURE, SUCCESS, USAGE_ERROR, run
from rce.errors import NotFound, RceError, Unauthorized
from tests.support.console import Console, Terminal, login, open_terminal, rce
from tests.support.master.served import PASSWORD, Served

HOME = Context("https://home:9000/", "ann", "rce_home", "1f")
BOBS_HOME = Context("https://home:9000/", "bob", "rce_bob", "2f", expires=2e9)


def test_end_of_input_at_the_prompt_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def press_ctrl_d(prompt: str) -> str:
        raise EOFError

    monkeypatch.setattr(sys, "stdin", Terminal())
    monkeypatch.setattr(getpass, "getpass", press_ctrl_d)
    with pytest.raises(RceError, match="no answer to 'Password of ann:'"):
        read_password("Password of ann: ")


def test_repetition_must_be_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = iter(["one", "two"])
    monkeypatch.setattr(sys, "stdin", Terminal())
    monkeypatch.setattr(getpass, "getpass", lambda prompt: next(answers))
    with pytest.raises(RceError, match="the passwords differ"):
        read_password("Password: ", repeat=True)


def test_password_is_a_line_of_standard_input_without_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("secret word\nrest\n"))
    assert read_password("Password: ") == "secret word"


async def test_login_keeps_a_key_that_only_its_user_can_read(served: Served) -> None:
    await login(served.url, "ann", "home")
    assert stat.S_IMODE(contexts.contexts_path().stat().st_mode) == 0o600
    assert stat.S_IMODE(contexts.contexts_path().parent.stat().st_mode) == 0o700
    text = contexts.contexts_path().read_text()
    assert PASSWORD not in text
    (context,) = contexts.load().contexts.values()
    me = await asyncio.to_thread(ApiClient(served.url, key=context.key).get, Whoami, "whoami")
    assert (me.user, me.role, me.key) == ("ann", "user", context.id)
    assert context.expires


async def test_logout_revokes_the_key(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    await login(served.url, "ann", "home")
    key = contexts.load().contexts["home"].key
    assert await rce("logout") == SUCCESS
    assert not contexts.load().contexts
    with pytest.raises(Unauthorized):
        await asyncio.to_thread(ApiClient(served.url, key=key).get, Whoami, "whoami")
    assert await rce("env", "list") == FAILURE
    assert "rce login URL" in capsys.readouterr().err


async def test_whoami_lists_permissions_on_request(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    await login(served.url, "vera", "home")
    assert await rce("whoami") == SUCCESS
    assert "rights" not in capsys.readouterr().out
    assert await rce("whoami", "--rights") == SUCCESS
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["data.read", "own"] in lines
    assert ["data.write", "-"] in lines


@pytest.mark.parametrize(
    ("known", "name"),
    [
        ({}, "home:9000"),
        ({"mine": HOME}, "mine"),
        ({"home:9000": BOBS_HOME}, "ann@home:9000"),
    ],
)
def test_context_is_named_after_its_host(known: dict[str, Context], name: str) -> None:
    assert _context_name(Contexts("", known), HOME.url, "ann") == name


def test_contexts_are_listed_with_a_star_at_the_current_one(
    no_context: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    contexts.save(Contexts("b", {"a": HOME, "b": BOBS_HOME}))
    assert run(["context", "list"]) == SUCCESS
    _, first, second = capsys.readouterr().out.splitlines()
    assert first.split() == ["a", "ann", HOME.url, "never", "expires"]
    assert second.split()[:3] == ["*", "b", "bob"]


def test_contexts_in_json_have_no_keys(no_context: Path, capsys: pytest.CaptureFixture[str]) -> None:
    contexts.save(Contexts("a", {"a": HOME}))
    assert run(["context", "list", "--json"]) == SUCCESS
    assert json.loads(capsys.readouterr().out) == {
        "current": "a",
        "contexts": {"a": {"url": HOME.url, "user": "ann", "expires": None}},
    }


def test_logout_without_a_context_is_refused(no_context: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["logout"]) == FAILURE
    assert capsys.readouterr().err == "rce: you are not signed in\n"


def test_context_of_an_unreachable_platform_is_removed_with_a_note(
    no_context: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    contexts.save(Contexts("a", {"a": Context("http://127.0.0.1:1/", "ann", "rce_k", "1f"), "b": HOME}))
    assert run(["logout"]) == SUCCESS
    assert contexts.load() == Contexts("", {"b": HOME})  # no other platform takes its place silently
    printed = capsys.readouterr()
    assert "the key 1f could not be revoked" in printed.err
    assert "no context is current: choose one with `rce context use NAME` (b)" in printed.out


async def test_user_is_asked_for(
    served: Served, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n"))
    assert await rce("login", served.url) == FAILURE
    assert capsys.readouterr().err == "User: rce: no answer to 'User:'\n"


@pytest.mark.parametrize(("url", "reason"), [("foo", "must begin with http"), ("http://127.0.0.1:1/", "refused")])
def test_url_is_checked_before_anything_is_asked(
    no_context: Path, capsys: pytest.CaptureFixture[str], url: str, reason: str
) -> None:
    assert run(["login", url]) == FAILURE
    printed = capsys.readouterr().err
    assert reason in printed
    assert "User:" not in printed


def test_watch_repeats_a_command_until_it_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pauses: list[float] = []
    monkeypatch.setattr(time, "sleep", pauses.append)
    console = Console([], [], NotFound("it is gone"))
    assert console.run("watch -n 0.5 node list brain") == FAILURE
    assert pauses == [0.5, 0.5]
    printed = capsys.readouterr()
    assert printed.out.count("every 0.5 s: node list brain    ") == 3
    assert printed.err.endswith("node: it is gone\n")


def test_ctrl_c_ends_watch_without_an_error() -> None:
    assert Console(KeyboardInterrupt()).run("watch node list brain") == SUCCESS


def test_watch_clears_the_screen_of_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = open_terminal(monkeypatch, 80)
    Console(KeyboardInterrupt()).run("watch node list brain")
    assert terminal.getvalue().startswith("\x1b[H\x1b[2Jevery 2 s: node list brain")


def test_script_of_a_file_is_run_in_the_session_of_its_command(tmp_path: Path) -> None:
    script = tmp_path / "setup.rce"
    script.write_text("env delete a\nnothing\nenv delete b\n")
    console = Console()
    assert console.run(f"console {script}") == USAGE_ERROR
    assert [each.line for each in console.api.requests] == ["DELETE environments/a"]
    assert console.run(f"console --keep-going {script}") == USAGE_ERROR
    assert len(console.api.requests) == 3


def test_script_is_read_from_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("env delete a\n"))
    console = Console()
    assert console.run("console") == SUCCESS
    assert len(console.api.requests) == 1


def test_help_in_the_console_lists_its_commands(capsys: pytest.CaptureFixture[str]) -> None:
    console = Console()
    console.session.in_console = True
    assert console.run("help") == SUCCESS
    assert capsys.readouterr().out == table.console_overview() + "\n"
