"""Steps of `provision`: progress, log, errors."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from provisioning import (
    steps,
)


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(steps, "LOG", tmp_path / "log")
    return tmp_path / "log"


def test_finished_steps_are_skipped(capsys: pytest.CaptureFixture[str]) -> None:
    done: list[str] = []

    def act() -> str:
        done.append("second")
        return "with a remark"

    steps.run_steps([steps.Step("first", lambda: "", act), steps.Step("second", lambda: "do it", act)])
    assert done == ["second"]
    first, second = capsys.readouterr().out.splitlines()
    assert first.split() == ["first", "already", "done"]
    assert second.startswith("second           with a remark (")


def test_progress_is_shown_on_a_terminal(
    log: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "30")
    steps.run_steps([steps.check_step("slow", "echo", "downloading a large file")])
    printed = capsys.readouterr().out.split("\x1b[18G\x1b[K")
    assert printed[:2] == ["slow             ", "downloading "]  # cut to the width
    assert printed[-1].startswith("done (")


def test_failed_step_ends_the_run_and_shows_its_last_lines(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program = "import sys; print(*range(1000), sep='\\n'); sys.exit(3)"
    doomed = [steps.check_step("doomed", sys.executable, "-c", program), steps.check_step("never", "true")]
    with pytest.raises(steps.ProvisioningError) as caught:
        steps.run_steps(doomed)
    assert capsys.readouterr().out.split() == ["doomed", "failed"]
    text = str(caught.value)
    assert text.startswith("970\n971\n")
    assert "exited with status 3" in text
    assert str(log) in text
    assert "500" in log.read_text().splitlines()


def test_secrets_are_not_logged(log: Path) -> None:
    assert steps.run("cat", secret="s3cret") == "s3cret"
    assert log.read_text() == "\n$ cat …\n"


def test_program_that_ignores_its_input(log: Path) -> None:
    assert steps.run("true", secret="x" * 1_000_000) == ""


@pytest.mark.usefixtures("log")
def test_missing_program() -> None:
    with pytest.raises(steps.ProvisioningError, match="no-such-program cannot be run"):
        steps.run("no-such-program")


def test_old_python_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "version_info", (3, 10, 2))
    with pytest.raises(steps.ProvisioningError, match=r"RCE runs on 3\.11 to 3\.13"):
        steps.check_python()
