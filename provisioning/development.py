"""The commands for a checkout: `demo`, `test` and `image` in its own `.venv`. Standard library only."""

from __future__ import annotations

import argparse
import contextlib
import glob
import hashlib
import json
import os
import pwd
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from provisioning.steps import ROOT, Failed, Step, add_command, begin_log, check_step, perform, run, show

if TYPE_CHECKING:
    from provisioning.steps import Commands

SCRIPT = ROOT / "provisioning" / "provision"
VENV = ROOT / ".venv"
PYTHON = VENV / "bin" / "python"
STAMP = VENV / "provisioned.json"
DEMO_EXTRAS = ("server", "mapping", "ros")
IMAGE_EXTRAS = ("server", "docker")
TEST_EXTRAS = (*DEMO_EXTRAS, "images", "docker", "bench", "postgresql", "dev")
TEST_PACKAGE = ROOT / "tests" / "ros" / "Test"
DOCKER_PROGRAMS = {  # a private daemon, what makes images without a registry, and disks and networks of environments
    "docker.io": "dockerd",
    **{name: name for name in ("containerd", "runc", "iptables", "debootstrap")},
    "e2fsprogs": "mkfs.ext4",
    "mount": "losetup",
    "iproute2": "ip",
}
BROWSER_PROGRAMS = {"nodejs": "node", "chromium": "chromium"}  # not every distribution has both as packages
IN_TWO_PROCESSES = ("-n", "2", "--dist", "loadgroup", "--no-loadscope-reorder", "--reruns", "1")
"""The groups are made in tests/conftest.py. What fails beside other work is tried once more, and counted as a rerun."""
IS_ROOT = os.geteuid() == 0


def missing_debian(tests: bool) -> list[str]:
    """Debian packages for what this machine lacks. Debian ships Python without what makes virtual environments."""
    minor = f"python3.{sys.version_info.minor}"
    headers = Path(sysconfig.get_path("include")) / "Python.h"
    wanted: dict[str, object] = {
        "g++": shutil.which("g++"),
        f"{minor}-dev": headers.exists(),
        f"{minor}-venv": PYTHON.exists() or find_spec("ensurepip"),
        "postgresql": not tests or postgresql_program("initdb"),
    }
    if tests:
        wanted |= {package: shutil.which(program) for package, program in BROWSER_PROGRAMS.items()}
    if tests and IS_ROOT and "DOCKER_HOST" not in os.environ:
        wanted |= {package: system_program(program) for package, program in DOCKER_PROGRAMS.items()}
    return [package for package, present in wanted.items() if not present]


def system_program(name: str) -> str | None:
    """Also one that is for root only, and not on other users' PATH."""
    return shutil.which(name, path=f"{os.environ.get('PATH', os.defpath)}:/usr/sbin:/sbin")


def install_debian(tests: bool) -> str:
    packages = missing_debian(tests)
    command = f"apt-get install {' '.join(packages)}"
    if IS_ROOT and shutil.which("apt-get"):
        quiet = {"DEBIAN_FRONTEND": "noninteractive"}
        run("apt-get", "update", environment=quiet)
        install = ("apt-get", "install", "-y", "--no-install-recommends")
        needed = [package for package in packages if package not in BROWSER_PROGRAMS]
        if needed:
            run(*install, *needed, environment=quiet)
        for package in set(packages) - set(needed):
            try:
                run(*install, package, environment=quiet)
            except Failed:
                print(f"goes on without {package}: the tests that need it are skipped", file=sys.stderr)
        return f"installed {' '.join(package for package in packages if package in needed or _there(package))}"
    if any(package.endswith("-venv") for package in packages):
        raise Failed(f"virtual environments need a package of the system's; as root: {command}")
    return f"goes on without what needs {', '.join(packages)}; for all of it, as root: {command}"


def _there(package: str) -> bool:
    return shutil.which(BROWSER_PROGRAMS[package]) is not None


def make_venv() -> str:
    run(sys.executable, "-m", "venv", "--clear", VENV)
    return str(VENV)


def wanted_stamp(extras: Sequence[str]) -> dict[str, object]:
    content = (ROOT / "pyproject.toml").read_bytes()
    return {"pyproject": hashlib.sha256(content).hexdigest(), "extras": sorted(extras)}


def is_installed(extras: Sequence[str]) -> bool:
    """Whether the extras were installed from pyproject.toml as it is now."""
    try:
        stamp = json.loads(STAMP.read_text())
    except (FileNotFoundError, json.JSONDecodeError):
        return False
    wanted = wanted_stamp(extras)
    return PYTHON.exists() and stamp["pyproject"] == wanted["pyproject"] and set(extras) <= set(stamp["extras"])


def install_project(extras: Sequence[str]) -> str:
    run(PYTHON, "-m", "pip", "install", "--disable-pip-version-check", "-e", f"{ROOT}[{','.join(extras)}]")
    STAMP.write_text(json.dumps(wanted_stamp(extras)))
    return f"rce[{','.join(extras)}]"


def build_typesupport(packages: Sequence[Path]) -> str:
    if shutil.which("g++") is None or not (Path(sysconfig.get_path("include")) / "Python.h").exists():
        return "skipped: needs g++ and Python's headers"
    return run(PYTHON, "-P", "-m", "provisioning.typesupport", *packages).strip().splitlines()[-1]


def install_steps(extras: Sequence[str], tests: bool) -> list[Step]:
    """What all commands have in common: a virtual environment with RCE in it."""
    return [
        Step("system packages", lambda: " ".join(missing_debian(tests)), lambda: install_debian(tests)),
        Step("virtual env", lambda: "" if PYTHON.exists() else f"make {VENV}", make_venv),
        Step(
            "python packages",
            lambda: "" if is_installed(extras) else f"install rce[{','.join(extras)}] and what it needs",
            lambda: install_project(extras),
        ),
    ]


def setup_steps(extras: Sequence[str], packages: Sequence[Path], tests: bool) -> list[Step]:
    """What demo and test have in common: RCE and the types of its messages."""
    types = Step("type support", lambda: "build what is not in its cache yet", lambda: build_typesupport(packages))
    return [*install_steps(extras, tests), types]


# --- PostgreSQL for the tests -----------------------------------------------------------------------------------------


def postgresql_program(name: str) -> str | None:
    """Debian keeps PostgreSQL's programs off PATH, by version."""
    return shutil.which(name) or next(iter(sorted(glob.glob(f"/usr/lib/postgresql/*/bin/{name}"), reverse=True)), None)


def has_user(name: str) -> bool:
    return any(user.pw_name == name for user in pwd.getpwall())


@contextlib.contextmanager
def postgresql() -> Iterator[dict[str, str]]:
    """A private PostgreSQL for as long as the context lasts; gives the variable that tells the tests its URL.

    It listens on a socket in its own directory only. It refuses to run as root, so then it runs as the user that its
    package has made.
    """
    initdb, pg_ctl = postgresql_program("initdb"), postgresql_program("pg_ctl")
    if not initdb or not pg_ctl or "RCE_TEST_POSTGRES" in os.environ or (IS_ROOT and not has_user("postgres")):
        yield {}
        return
    with tempfile.TemporaryDirectory(prefix="rce-postgresql-") as directory:
        user = ["runuser", "-u", "postgres", "--"] if IS_ROOT else []
        if IS_ROOT:
            shutil.chown(directory, "postgres", "postgres")
        data = f"{directory}/data"
        options = f"-F -c listen_addresses= -k {directory}"
        run(*user, initdb, "-D", data, "-U", "rce", "-A", "trust", "-E", "UTF8", "--locale=C", "--no-sync")
        run(*user, pg_ctl, "-D", data, "-w", "-o", options, "-l", f"{directory}/log", "start")
        try:
            yield {"RCE_TEST_POSTGRES": f"postgresql+psycopg://rce@/postgres?host={directory}"}
        finally:
            run(*user, pg_ctl, "-D", data, "-m", "immediate", "stop")


# --- commands ---------------------------------------------------------------------------------------------------------


def demo(options: argparse.Namespace, rest: list[str]) -> int:
    """Install RCE, then map a building with it: a simulated one, or the recording of --log."""
    source = [str(options.log.resolve())] if options.log else ["--simulate"]
    command = [str(VENV / "bin" / "rce"), "map", *source, "--out", str(options.out.resolve()), *rest]
    steps = setup_steps(DEMO_EXTRAS, [], tests=False)
    if options.dry_run:
        show(steps, command)
        return 0
    begin_log()
    perform(steps)
    return hand_over(command)


def test(options: argparse.Namespace, rest: list[str]) -> int:
    """Install all that the tests need, then check and test; further arguments go to pytest."""
    command = [str(PYTHON), "-m", "pytest", *IN_TWO_PROCESSES, *rest]
    tool = VENV / "bin"
    steps = [
        *setup_steps(TEST_EXTRAS, [TEST_PACKAGE], tests=True),
        check_step("ruff check", tool / "ruff", "check", ".", SCRIPT),
        check_step("ruff format", tool / "ruff", "format", "--check", ".", SCRIPT),
        check_step("mypy", tool / "mypy"),
        check_step("mypy provision", tool / "mypy", "--scripts-are-modules", SCRIPT),
    ]
    if options.dry_run:
        show(steps, command)
        return 0
    begin_log()
    perform(steps)
    with postgresql() as variables:
        return hand_over(command, cwd=ROOT, environment=variables)


def image(options: argparse.Namespace, rest: list[str]) -> int:
    """Build the images of environments for the engine docker, with the daemon of DOCKER_HOST or this machine's."""
    command = [str(PYTHON), "-P", "-m", "provisioning.image", *rest]
    steps = install_steps(IMAGE_EXTRAS, tests=False)
    if options.dry_run:
        show(steps, command)
        return 0
    begin_log()
    perform(steps)
    return hand_over(command, cwd=ROOT)


def add_commands(commands: Commands) -> None:
    mapping = add_command(commands, demo, passes_on=True)
    mapping.add_argument("--log", type=Path, metavar="FILE", help="a recording: CARMEN log or ROS bag")
    mapping.add_argument("--out", type=Path, default=Path("rce-demo"), metavar="DIR", help="(%(default)s)")
    add_command(commands, test, passes_on=True)
    add_command(commands, image, passes_on=True)


def hand_over(command: Sequence[str], cwd: Path | None = None, environment: dict[str, str] | None = None) -> int:
    """Let the program that all was made ready for have the terminal; its exit status."""
    program = subprocess.Popen(command, cwd=cwd, env={**os.environ, **(environment or {})})
    try:
        while True:
            with contextlib.suppress(KeyboardInterrupt):  # the terminal tells the program as well, and it cleans up
                return program.wait()
    finally:
        program.terminate()
        program.wait()
