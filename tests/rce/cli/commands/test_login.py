"""Passwords are read from a terminal, or from standard input."""

from __future__ import annotations

import getpass
import io
import sys

import pytest

from rce.cli.commands.login import read_password
from rce.errors import RceError


class Terminal(io.StringIO):
    """Standard input that is a terminal."""

    def isatty(self) -> bool:
        return True


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
