"""`python -m master`: what stops it from starting is said in one sentence."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from rce.sole import sole_user


def refusal(directory: Path, *more: str) -> str:
    words = [sys.executable, "-P", "-m", "master", f"--data-dir={directory}", "--http=tcp:0:interface=127.0.0.1"]
    ended = subprocess.run(
        [*words, "--control=tcp:0:interface=127.0.0.1", *more], capture_output=True, text=True, timeout=60
    )
    event = json.loads(ended.stderr)
    assert (ended.returncode, event["level"], "traceback" in event) == (1, "error", False)
    return str(event["message"])


def test_two_masters_do_not_share_a_directory(tmp_path: Path) -> None:
    with sole_user(tmp_path, "Master"):
        assert refusal(tmp_path).startswith(f"another Master works in {tmp_path}: end it, or")


def test_a_directory_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert refusal(tmp_path / "file" / "master") == f"{tmp_path}/file/master: not a directory"


def test_a_damaged_database_is_named_with_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "master.db").write_bytes(b"no database" * 1000)
    told = refusal(tmp_path)
    assert f"{tmp_path}/master.db" in told
    assert "file is not a database; see that" in told
    assert "sqlalche.me" not in told


def test_an_address_that_is_none_is_shown_with_one_that_is(tmp_path: Path) -> None:
    assert refusal(tmp_path, "--http=9000").startswith("'9000' is no Twisted server endpoint such as tcp:9000 or")
    assert not (tmp_path / "master.db").exists()  # no password was made that nobody has seen
