"""systemd units: accepted by systemd, with few rights."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from provisioning import (
    system,
    units,
)

ANALYZE = shutil.which("systemd-analyze")

needs_analyze = pytest.mark.skipif(ANALYZE is None, reason="needs systemd-analyze: apt-get install systemd")

CASES = [
    ("master", ""),
    ("robot", ""),
    ("map-service", ""),
    ("knowledge-service", ""),
    ("container", "process"),
    ("container", "docker"),
]


@pytest.fixture
def unit_file(tmp_path: Path) -> Callable[[str, str], Path]:
    def write(role: str, engine: str) -> Path:
        """Write a unit whose program exists."""
        text = units.text(role, engine)
        assert f"ExecStart={system.CURRENT}/bin/rce {role} --config /etc/rce/{role}.toml\n" in text
        file = tmp_path / system.unit(role)
        file.write_text(text.replace(f"{system.CURRENT}/bin/rce", "/bin/true"))
        return file

    return write


@needs_analyze
@pytest.mark.parametrize(("role", "engine"), CASES)
def test_systemd_accepts_units(unit_file: Callable[[str, str], Path], role: str, engine: str) -> None:
    command = [str(ANALYZE), "verify", "--man=no", str(unit_file(role, engine))]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert (done.returncode, done.stdout) == (0, "")


@needs_analyze
@pytest.mark.parametrize(("role", "engine"), CASES)
def test_exposure_of_units_is_low(unit_file: Callable[[str, str], Path], role: str, engine: str) -> None:
    """The threshold is ten times systemd's exposure level; 100 is the worst."""
    most = 20 if role == "container" else 15
    command = [str(ANALYZE), "security", "--offline=true", f"--threshold={most}", str(unit_file(role, engine))]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(("role", "engine"), CASES)
def test_services_have_limits_unless_environments_run_in_them(role: str, engine: str) -> None:
    limited = (role, engine) != ("container", "process")
    text = units.text(role, engine)
    assert ("\nMemoryMax=" in text) == ("\nMemorySwapMax=0\n" in text) == limited
    assert ("\nTasksMax=infinity\n" in text) != limited
    assert "\nOOMPolicy=continue\n" in text  # else a killed worker or node would stop its service


def test_only_the_task_set_has_access_to_docker() -> None:
    assert "SupplementaryGroups=docker" in units.text("container", "docker")
    for role, engine in CASES[:-1]:
        assert "docker" not in units.text(role, engine)


def test_only_a_task_set_with_docker_has_net_admin() -> None:
    assert "AmbientCapabilities=CAP_NET_ADMIN\n" in units.text("container", "docker")
    for role, engine in [*CASES[:-1], ("container", "swarm")]:
        assert "CAP_" not in units.text(role, engine)


def test_secrets_of_the_master_are_hidden_from_other_services() -> None:
    for role in ("robot", "container", "map-service", "knowledge-service"):
        for path in ("/etc/rce/authority", "/etc/rce/master.toml", "/var/lib/rce/master"):
            assert f"InaccessiblePaths=-{path}\n" in units.text(role, "docker")


def system_calls(name: str) -> set[str]:
    """Return the system calls of a set, such as `@resources`."""
    done = subprocess.run(
        [str(ANALYZE), "syscall-filter", "--no-pager", name], capture_output=True, text=True, check=True
    )
    words = {word for line in done.stdout.splitlines()[1:] if not (word := line.strip()).startswith("#") and word}
    inner = {word for word in words if word.startswith("@")}
    return (words - inner).union(*map(system_calls, inner))


def allowed(text: str) -> set[str]:
    """Return the system calls that a unit allows, as systemd reads its lines one after the other."""
    found: set[str] = set()
    for line in re.findall(r"^SystemCallFilter=(.+)$", text, re.MULTILINE):
        names = line.removeprefix("~").split()
        calls = set().union(*(system_calls(name) if name.startswith("@") else {name} for name in names))
        found = found - calls if line.startswith("~") else found | calls
    return found


@needs_analyze
@pytest.mark.parametrize(
    ("role", "needed"),
    [
        ("robot", {"prlimit64", "setpriority"}),  # endpoints/robot/worker.py
        ("map-service", {"prlimit64", "setpriority"}),  # rce/mapservice/job_program.py
        ("knowledge-service", {"prlimit64"}),  # rce/knowledge/sandbox.py
    ],
)
def test_workers_may_limit_themselves(role: str, needed: set[str]) -> None:
    calls = allowed(units.text(role))
    assert needed <= calls
    assert "chown" not in calls
