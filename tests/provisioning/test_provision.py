"""The script `provision`: its plan, its steps, what it says when one fails."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from provisioning import development, steps

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "provisioning" / "provision"


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """As much of a fresh checkout as the script looks at."""
    (tmp_path / "provisioning").mkdir()
    for path in [SCRIPT, *SCRIPT.parent.glob("*.py")]:
        shutil.copy(path, tmp_path / "provisioning")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(steps, "LOG", tmp_path / "log")
    return tmp_path / "log"


def plan(checkout: Path, *arguments: str) -> str:
    before = sorted(checkout.rglob("*"))
    command = [sys.executable, str(checkout / "provisioning" / "provision"), *arguments]
    done = subprocess.run(command, cwd=checkout, capture_output=True, text=True, check=True)
    assert sorted(checkout.rglob("*")) == before
    return done.stdout


def test_dry_run_of_test_prints_the_plan_and_touches_nothing(checkout: Path) -> None:
    lines = plan(checkout, "test", "--dry-run", "-k", "some thing", "tests/rce").splitlines()
    names = ["system packages", "virtual env", "python packages", "type support"]
    checks = ["ruff check", "ruff format", "mypy", "mypy provision", "run"]
    assert [line[:16].strip() for line in lines] == names + checks
    assert lines[-1].endswith(f"-m pytest {' '.join(development.IN_TWO_PROCESSES)} -k 'some thing' tests/rce")
    assert f"make {checkout}/.venv" in lines[1]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ((), "map --simulate --out {0}/rce-demo"),
        (("--log", "a.clf", "--out", "maps"), "map {0}/a.clf --out {0}/maps"),
        (("--seed", "3"), "map --simulate --out {0}/rce-demo --seed 3"),
    ],
)
def test_dry_run_of_demo(checkout: Path, arguments: tuple[str, ...], expected: str) -> None:
    assert plan(checkout, "demo", "--dry-run", *arguments).splitlines()[-1].endswith(expected.format(checkout))


def test_dry_run_of_image(checkout: Path) -> None:
    lines = plan(checkout, "image", "--dry-run").splitlines()
    assert [line[:16].strip() for line in lines] == ["system packages", "virtual env", "python packages", "run"]
    assert "rce[server,docker]" in lines[2]
    assert lines[-1].endswith("-P -m provisioning.image")


def test_steps_that_are_done_are_not_done_again(capsys: pytest.CaptureFixture[str]) -> None:
    done: list[str] = []

    def act() -> str:
        done.append("second")
        return "with a remark"

    steps.perform([steps.Step("first", lambda: "", act), steps.Step("second", lambda: "do it", act)])
    assert done == ["second"]
    first, second = capsys.readouterr().out.splitlines()
    assert first.split() == ["first", "already", "done"]
    assert second.startswith("second           with a remark (")


def test_a_terminal_sees_what_a_step_is_at(
    log: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "30")
    steps.perform([steps.check_step("slow", "echo", "downloading a large file")])
    shown = capsys.readouterr().out.split("\x1b[18G\x1b[K")
    assert shown[:2] == ["slow             ", "downloading "]  # as much as there is room for
    assert shown[-1].startswith("done (")


def test_a_failed_step_shows_its_last_lines_and_the_log(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program = "import sys; print(*range(1000), sep='\\n'); sys.exit(3)"
    doomed = [steps.check_step("doomed", sys.executable, "-c", program), steps.check_step("never", "true")]
    with pytest.raises(steps.Failed) as caught:
        steps.perform(doomed)
    assert capsys.readouterr().out.split() == ["doomed", "failed"]
    text = str(caught.value)
    assert text.startswith("970\n971\n")
    assert "ended with status 3" in text
    assert str(log) in text
    assert "500" in log.read_text().splitlines()


def test_secrets_stay_out_of_the_log(log: Path) -> None:
    assert steps.run("cat", secret="s3cret") == "s3cret"
    assert log.read_text() == "\n$ cat …\n"


def test_who_reads_no_secret(log: Path) -> None:
    assert steps.run("true", secret="x" * 1_000_000) == ""


@pytest.mark.usefixtures("log")
def test_a_program_that_is_not_there() -> None:
    with pytest.raises(steps.Failed, match="no-such-program cannot be run"):
        steps.run("no-such-program")


def test_installed_until_pyproject_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for name, path in {"ROOT": tmp_path, "PYTHON": tmp_path / "python", "STAMP": tmp_path / "stamp"}.items():
        monkeypatch.setattr(development, name, path)
    development.PYTHON.touch()
    assert not development.is_installed(["ros"])
    development.STAMP.write_text(json.dumps(development.wanted_stamp(["ros", "server"])))
    assert development.is_installed(["ros"])
    assert not development.is_installed(["ros", "dev"])
    with (tmp_path / "pyproject.toml").open("a") as file:
        file.write("# changed\n")
    assert not development.is_installed(["ros"])


def test_without_root_it_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(development, "IS_ROOT", False)
    monkeypatch.setattr(development, "missing_debian", lambda tests: ["g++", "postgresql"])
    assert "apt-get install g++ postgresql" in development.install_debian(tests=True)
    monkeypatch.setattr(development, "missing_debian", lambda tests: ["python3.11-venv"])
    with pytest.raises(steps.Failed, match=r"as root: apt-get install python3\.11-venv"):
        development.install_debian(tests=True)


def test_an_old_python_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "version_info", (3, 10, 2))
    with pytest.raises(steps.Failed, match=r"RCE runs on 3\.11 to 3\.13"):
        steps.check_python()


def test_the_status_is_that_of_the_last_program() -> None:
    program = "import os, sys; sys.exit(int(os.environ['STATUS']))"
    assert development.hand_over([sys.executable, "-c", program], environment={"STATUS": "7"}) == 7


def test_what_a_distribution_lacks_for_the_browser_does_not_stop_the_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def run(*command: str | Path, environment: object = None) -> str:
        asked.append(" ".join(map(str, command)))
        if "chromium" in command:
            raise steps.Failed("Unable to locate package chromium")
        return ""

    monkeypatch.setattr(development, "IS_ROOT", True)
    monkeypatch.setattr(development, "run", run)
    monkeypatch.setattr(development.shutil, "which", lambda name: None if name == "chromium" else f"/usr/bin/{name}")
    monkeypatch.setattr(development, "missing_debian", lambda tests: ["g++", "chromium"])
    assert development.install_debian(tests=True) == "installed g++"
    assert asked[-1].endswith("chromium")
