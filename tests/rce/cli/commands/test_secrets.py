"""`secret`."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from rce.api.views import SecretView
from rce.cli.execute import FAILURE
from tests.support.console import Console, Request


def test_secret_is_read_from_standard_input_or_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("hidden\n"))
    assert Console().request("secret set database") == Request(
        "POST secrets", {}, {"name": "database", "value": "hidden"}
    )
    file = tmp_path / "s"
    file.write_text("two\nlines\n")
    assert Console().request(f"secret set database --file {file}").body["value"] == "two\nlines\n"


def test_what_is_no_text_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "s"
    file.write_bytes(b"\xff")
    assert Console().run(f"secret set database --file {file}") == FAILURE
    assert Console().run(f"secret set database --file {tmp_path}/none") == FAILURE
    assert "base64" in capsys.readouterr().err


def test_names_are_listed_and_removed(capsys: pytest.CaptureFixture[str]) -> None:
    assert Console([SecretView("database", 1e9)]).request("secret list").line == "GET secrets"
    assert "database" in capsys.readouterr().out
    assert Console().request("secret remove database").line == "DELETE secrets/database"
