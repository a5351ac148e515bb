"""`login`, `logout`, `context`, `whoami`, and the console's own commands."""

from __future__ import annotations

import asyncio
import getpass
import io
import stat
import sys

import pytest

from rce.api.client import ApiClient
from rce.api.views import Whoami
from rce.cli import contexts
from rce.cli.commands.login import read_password
from rce.cli.execute import FAILURE, SUCCESS
from rce.errors import RceError, Unauthorized
from tests.support.console import Terminal, login, rce
from tests.support.master.served import PASSWORD, Served


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
