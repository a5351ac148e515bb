"""Completion scripts, run by their shells with a stand-in for the command."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from rce.cli.completion_scripts import BASH, SCRIPTS
from rce.cli.execute import SUCCESS, run

STAND_IN = """\
#!/bin/sh
printf '%s\\n' "$@" > "$ARGUMENTS"
printf 'brain\\tthe first\\nbrawn\\nr2:x\\n'
"""


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """File with the arguments of the last call of `rce`."""
    program = tmp_path / "rce"
    program.write_text(STAND_IN)
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    monkeypatch.setenv("ARGUMENTS", str(tmp_path / "arguments"))
    return tmp_path / "arguments"


def bash(script: str) -> str:
    return subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=30, check=True).stdout


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize(
    ("words", "asked", "expected"),
    [
        (["rce", "env", "show", "bra"], ["complete", "env", "show", "bra"], ["brain", "brawn"]),
        (["rce", "env", "show", ""], ["complete", "env", "show", ""], ["brain", "brawn", "r2:x"]),
    ],
)
def test_bash_offers_the_candidates_of_the_word_at_the_cursor(
    words: list[str], asked: list[str], expected: list[str], stand_in: Path
) -> None:
    quoted = " ".join(f"'{word}'" for word in words)
    script = f'{BASH}\nCOMP_WORDS=({quoted}); COMP_CWORD={len(words) - 1}; _rce; printf "%s\\n" "${{COMPREPLY[@]}}"'
    assert bash(script).split() == expected
    assert stand_in.read_text().split("\n")[:-1] == asked


@pytest.mark.parametrize("shell", SCRIPTS)
def test_script_has_the_syntax_of_its_shell(shell: str, tmp_path: Path) -> None:
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"needs {shell}")
    (tmp_path / "script").write_text(SCRIPTS[shell])
    checked = subprocess.run([program, "-n", tmp_path / "script"], capture_output=True, text=True, timeout=30)
    assert (checked.returncode, checked.stderr) == (0, "")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_script_is_printed_unchanged(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["completion", shell]) == SUCCESS
    assert capsys.readouterr().out == SCRIPTS[shell]
