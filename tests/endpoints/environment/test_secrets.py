"""Secrets in an environment: files that only its user reads, and variables."""

from __future__ import annotations

from pathlib import Path

from endpoints.environment.secrets import DIRECTORY, Secrets
from rce.control.calls.endpoints import Secret


def test_secrets_are_files_and_variables_until_they_are_removed(tmp_path: Path) -> None:
    variables = {"KEPT": "1"}
    secrets = Secrets("f" * 32, variables, tmp_path)
    secrets.put({"database": Secret("PASSWORD", "hidden"), "other": Secret("", "ä")})
    assert variables == {"KEPT": "1", "PASSWORD": "hidden", DIRECTORY: str(secrets.directory)}
    files = {path.name: (path.read_text(), path.stat().st_mode & 0o777) for path in secrets.directory.iterdir()}
    assert files == {"database": ("hidden", 0o400), "other": ("ä", 0o400)}
    assert secrets.directory.stat().st_mode & 0o777 == 0o700
    secrets.put({"other": Secret("", "new")})
    assert [path.name for path in secrets.directory.iterdir()] == ["other"]
    assert "PASSWORD" not in variables
    secrets.remove()
    assert variables == {"KEPT": "1"}
    assert list(tmp_path.iterdir()) == []


def test_same_secrets_stay_as_they_are(tmp_path: Path) -> None:
    secrets = Secrets("f" * 32, {}, tmp_path)
    secrets.put({"a": Secret("", "x")})
    before = (secrets.directory / "a").stat().st_ino
    secrets.put({"a": Secret("", "x")})
    assert (secrets.directory / "a").stat().st_ino == before
    secrets.put({})
    assert list(tmp_path.iterdir()) == []
