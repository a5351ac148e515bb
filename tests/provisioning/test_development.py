"""Commands for a checkout: `provision test`, `demo` and `image`."""

from __future__ import annotations

import itertools
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from _pytest.mark.expression import Expression

from provisioning import development, steps
from provisioning.steps import CONSTRAINTS, ProvisioningError
from tests.support.paths import ROOT

SCRIPT = ROOT / "provisioning" / "provision"


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """The files of a fresh checkout that the script reads."""
    (tmp_path / "provisioning").mkdir()
    for path in [SCRIPT, *SCRIPT.parent.glob("*.py"), CONSTRAINTS]:
        shutil.copy(path, tmp_path / "provisioning")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def plan(checkout: Path, *arguments: str) -> str:
    before = sorted(checkout.rglob("*"))
    command = [sys.executable, str(checkout / "provisioning" / "provision"), *arguments]
    done = subprocess.run(command, cwd=checkout, capture_output=True, text=True, check=True)
    assert sorted(checkout.rglob("*")) == before
    return done.stdout


INSTALLATION = ["system packages", "virtual env", "python packages", "type support", "kernels"]

CHECKS = ["ruff check", "ruff format", "mypy", "mypy provision"]


def test_dry_run_of_test_prints_the_plan_and_changes_nothing(checkout: Path) -> None:
    lines = plan(checkout, "test", "--dry-run", "-k", "some thing", "tests/rce").splitlines()
    assert [line[:16].strip() for line in lines] == [*INSTALLATION, *CHECKS, "run"]
    assert lines[-1].endswith(f"-m pytest {' '.join(development.IN_TWO_PROCESSES)} -k 'some thing' tests/rce")
    assert f"make {checkout}/.venv" in lines[1]


@pytest.mark.parametrize(
    ("option", "steps", "markers"),
    [
        ((), [*INSTALLATION, *CHECKS], [development.QUICK[1], development.REST[1]]),
        (("--quick",), [*INSTALLATION, *CHECKS], [development.QUICK[1]]),
        (("--rest",), INSTALLATION, [development.REST[1]]),
    ],
)
def test_stages_of_test(checkout: Path, option: tuple[str, ...], steps: list[str], markers: list[str]) -> None:
    lines = plan(checkout, "test", "--dry-run", *option).splitlines()
    assert [line[:16].strip() for line in lines] == [*steps, *("run" for _ in markers)]
    for line, marker in zip(lines[-len(markers) :], markers, strict=True):
        assert f" -m '{marker}'" in line


def test_pip_installs_where_uv_cannot(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    by_pip: list[tuple[object, ...]] = []

    def fail(*command: object, **_: object) -> str:
        raise ProvisioningError(f"{command} failed")

    monkeypatch.setattr(development, "run", fail)
    monkeypatch.setattr(development, "pip_install", lambda _python, *arguments: by_pip.append(arguments))
    monkeypatch.setattr(development, "STAMP", tmp_path / "stamp")
    assert development.install_project(["dev"]) == "rce[dev]"
    assert by_pip == [("uv",), ("-e", f"{ROOT}[dev]")]


def test_each_test_belongs_to_exactly_one_stage() -> None:
    """Those with a Kubernetes cluster have a stage of their own, of which CI runs a sample."""
    quick, rest, cluster = (
        Expression.compile(stage[1]) for stage in (development.QUICK, development.REST, development.KUBERNETES)
    )
    for markers in itertools.product((False, True), repeat=6):
        found = dict(zip(("e2e", "docker", "ros", "slow", "kubernetes", "sample"), markers, strict=True))
        if found["sample"] and not found["kubernetes"]:
            continue  # there is none
        stages = [stage.evaluate(lambda name, found=found, **_: found[name]) for stage in (quick, rest, cluster)]  # type: ignore[misc]
        assert stages == [
            not any(markers),
            found["sample"] or (any(markers) and not found["kubernetes"]),
            found["kubernetes"],
        ]


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


@pytest.mark.parametrize("changed", ["pyproject.toml", "constraints.txt"])
def test_changed_requirements_are_installed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: str
) -> None:
    for path in (ROOT / "pyproject.toml", CONSTRAINTS):
        shutil.copy(path, tmp_path)
    paths = {"ROOT": tmp_path, "CONSTRAINTS": tmp_path / "constraints.txt"}
    for name, path in {**paths, "PYTHON": tmp_path / "python", "STAMP": tmp_path / "stamp"}.items():
        monkeypatch.setattr(development, name, path)
    development.PYTHON.touch()
    assert not development.is_installed(["ros"])
    development.STAMP.write_text(json.dumps(development.current_stamp(["ros", "server"])))
    assert development.is_installed(["ros"])
    assert not development.is_installed(["ros", "dev"])
    with (tmp_path / changed).open("a") as file:
        file.write("# changed\n")
    assert not development.is_installed(["ros"])


def test_missing_packages_are_named_without_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(development, "IS_ROOT", False)
    monkeypatch.setattr(development, "missing_debian", lambda tests: ["g++", "postgresql"])
    assert "apt-get install g++ postgresql" in development.install_debian(tests=True)
    monkeypatch.setattr(development, "missing_debian", lambda tests: ["python3.11-venv"])
    with pytest.raises(steps.ProvisioningError, match=r"as root: apt-get install python3\.11-venv"):
        development.install_debian(tests=True)


def test_exit_status_of_the_program_is_returned() -> None:
    program = "import os, sys; sys.exit(int(os.environ['STATUS']))"
    assert development.run_in_foreground([sys.executable, "-c", program], environment={"STATUS": "7"}) == 7


@pytest.fixture
def apt(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """Commands that would have been run as root. The package `chromium` does not exist."""
    commands: list[str] = []

    def run(*command: str | Path, environment: object = None) -> str:
        assert development.POLICY.exists() is ("install" in command)
        commands.append(" ".join(map(str, command)))
        if "chromium" in command:
            raise steps.ProvisioningError("Unable to locate package chromium")
        return ""

    monkeypatch.setattr(development, "IS_ROOT", True)
    monkeypatch.setattr(development, "run", run)
    monkeypatch.setattr(development, "POLICY", tmp_path / "policy-rc.d")
    monkeypatch.setattr(development, "CLOUD_INIT_OFF", tmp_path / "cloud" / "cloud-init.disabled")
    monkeypatch.setattr(shutil, "which", lambda name, path="": f"/usr/bin/{name}")
    return commands


def test_packages_that_a_distribution_lacks_do_not_stop_the_tests(
    apt: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(development, "missing_debian", lambda tests: ["g++", "chromium", "zsh"])
    assert development.install_debian(tests=True) == "installed g++ zsh"
    assert [command.rpartition(" ")[2] for command in apt] == ["update", "g++", "chromium", "zsh"]


def test_installed_packages_start_no_services(apt: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(development, "missing_debian", lambda tests: ["prometheus", "cloud-init"])
    assert development.install_debian(tests=True) == "installed prometheus cloud-init"
    assert apt[-1] == "/usr/bin/update-rc.d prometheus disable"
    assert not development.POLICY.exists()
    assert development.CLOUD_INIT_OFF.exists()
