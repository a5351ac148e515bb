"""Commands for a checkout: `demo`, `test` and `image`, in its own `.venv`. Standard library only."""

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

from provisioning.steps import (
    CONSTRAINTS,
    ROOT,
    ProvisioningError,
    Step,
    add_command,
    check_step,
    pip_install,
    print_plan,
    run,
    run_steps,
    start_log,
)

if TYPE_CHECKING:
    from provisioning.steps import Commands

SCRIPT = ROOT / "provisioning" / "provision"
VENV = ROOT / ".venv"
PYTHON = VENV / "bin" / "python"
STAMP = VENV / "provisioned.json"
DEMO_EXTRAS = ("server", "knowledge", "bag", "mapping", "mapping3d", "ros", "images")  # the last for the examples
IMAGE_EXTRAS = ("server", "docker")
TEST_EXTRAS = (
    *(*DEMO_EXTRAS, "onnx", "dense", "video", "draco", "docker", "kubernetes", "bench", "postgresql"),
    *("docs", "dev"),
)
TEST_PACKAGE = ROOT / "tests" / "ros" / "Test"
DOCKER_PROGRAMS = {  # a private daemon, what makes images without a registry, and disks and networks of environments
    "docker.io": "dockerd",
    **{name: name for name in ("containerd", "runc", "iptables", "debootstrap")},
    "e2fsprogs": "mkfs.ext4",
    "mount": "losetup",
    "iproute2": "ip",
}
OPTIONAL_PROGRAMS = {  # single tests need them, and not every distribution has them as packages
    "nodejs": "node",
    "node-typescript": "tsc",
    "chromium": "chromium",
    "curl": "curl",
    "zsh": "zsh",
    "fish": "fish",
    "prometheus": "prometheus",
    "cloud-init": "cloud-init",
    "systemd": "systemd-analyze",
    "cmake": "cmake",
    "make": "make",
    "clang": "clang++",
}
INCLUDE = Path("/usr/include")
CPP_HEADERS = {  # of the C++ client
    "libboost-dev": "boost/beast.hpp",
    "libssl-dev": "openssl/ssl.h",
    "nlohmann-json3-dev": "nlohmann/json.hpp",
    "libsimdjson-dev": "simdjson.h",
}
KERNELS_OF_TESTS = (
    *("rce.planning.planner", "rce.mapping3d.pipeline"),
    *("rce.mapping3d.evaluation.building", "rce.mapping3d.evaluation.room"),
)
IN_TWO_PROCESSES = ("-n", "2", "--dist", "loadgroup", "--no-loadscope-reorder", "--max-worker-restart=1")
"""Options of pytest. tests/conftest.py makes the groups and their order. A process that ends is replaced once, because
pytest-xdist starts the test that ended it again."""
SLOW_FOLDERS = ("e2e", "chaos", "containers/nodes", "endpoints/environment", "provisioning")
"""Folders of tests that need ROS 2 or whole platforms, all of them: the quick tests need not import them."""
QUICK = (
    *("-m", "not (e2e or docker or kubernetes or ros or slow)"),
    *(f"--ignore=tests/{folder}" for folder in SLOW_FOLDERS),
)
REST = ("-m", "((e2e or docker or ros or slow) and not kubernetes) or sample")
KUBERNETES = ("-m", "kubernetes")
UV_OPTIONS = ("--compile-bytecode", "--constraints", CONSTRAINTS, "--build-constraints", CONSTRAINTS)
KEEP_BYTECODE = {"PYTHONDONTWRITEBYTECODE": ""}
"""Variables for the tests. They start hundreds of processes, each of which would compile the sources again."""
IS_ROOT = os.geteuid() == 0
APT_OPTIONS = ("-o", "Acquire::Retries=3", "-o", "DPkg::Lock::Timeout=300")  # a fresh machine may be updating itself
POLICY = Path("/usr/sbin/policy-rc.d")  # decides whether a package may start its services
CLOUD_INIT_OFF = Path("/etc/cloud/cloud-init.disabled")


def missing_debian(tests: bool) -> list[str]:
    """Return the Debian packages that this machine lacks.

    Debian ships Python without the module that makes virtual environments.
    """
    minor = f"python3.{sys.version_info.minor}"
    headers = Path(sysconfig.get_path("include")) / "Python.h"
    present: dict[str, object] = {
        "g++": shutil.which("g++"),
        f"{minor}-dev": headers.exists(),
        f"{minor}-venv": PYTHON.exists() or find_spec("ensurepip"),
        "postgresql": not tests or postgresql_program("initdb"),
    }
    if tests:
        present |= {package: shutil.which(program) for package, program in OPTIONAL_PROGRAMS.items()}
        present |= {package: (INCLUDE / header).exists() for package, header in CPP_HEADERS.items()}
        present["node-typescript"] = shutil.which("tsc") or shutil.which("npm")  # either is enough
    if tests and IS_ROOT and "DOCKER_HOST" not in os.environ:
        present |= {package: system_program(program) for package, program in DOCKER_PROGRAMS.items()}
    return [package for package, found in present.items() if not found]


def system_program(name: str) -> str | None:
    """Find a program, in root's directories too, which are not on other users' PATH."""
    return shutil.which(name, path=f"{os.environ.get('PATH', os.defpath)}:/usr/sbin:/sbin")


def install_debian(tests: bool) -> str:
    """Install the missing Debian packages as root; otherwise say which they are.

    Raises:
        ProvisioningError: A package that everything needs is missing.
    """
    packages = missing_debian(tests)
    command = f"apt-get install {' '.join(packages)}"
    if IS_ROOT and shutil.which("apt-get"):
        quiet = {"DEBIAN_FRONTEND": "noninteractive"}
        run("apt-get", *APT_OPTIONS, "update", environment=quiet)
        install = ("apt-get", *APT_OPTIONS, "install", "-y", "--no-install-recommends")
        needed = [package for package in packages if package not in {*OPTIONAL_PROGRAMS, *CPP_HEADERS}]
        missing: list[str] = []
        with services_off(packages):
            if needed:
                run(*install, *needed, environment=quiet)
            for package in packages:
                if package in needed:
                    continue
                try:
                    run(*install, package, environment=quiet)
                except ProvisioningError:
                    missing.append(package)
                    print(f"cannot install {package}: the tests that need it will be skipped", file=sys.stderr)
        return f"installed {' '.join(package for package in packages if package not in missing)}"
    if any(package.endswith("-venv") for package in packages):
        raise ProvisioningError(f"virtual environments need a package of the system; as root: {command}")
    return f"not installed: {', '.join(packages)}; the tests that need them will be skipped. As root: {command}"


@contextlib.contextmanager
def services_off(packages: Sequence[str]) -> Iterator[None]:
    """Keep packages that are installed meanwhile from starting services: the tests need their programs only.

    Neither Prometheus (port 9090) nor cloud-init, which configures users and network, runs after the next boot either.
    """
    own = not POLICY.exists()
    if own:
        POLICY.write_text("#!/bin/sh\nexit 101\n")  # "action forbidden by policy"
        POLICY.chmod(0o755)
    if "cloud-init" in packages:
        CLOUD_INIT_OFF.parent.mkdir(exist_ok=True)
        CLOUD_INIT_OFF.touch()
    try:
        yield
    finally:
        if own:
            POLICY.unlink(missing_ok=True)
    if "prometheus" in packages and shutil.which("prometheus") and system_program("update-rc.d"):
        run(system_program("update-rc.d") or "update-rc.d", "prometheus", "disable")


def make_venv() -> str:
    """Make the virtual environment anew and return its directory."""
    run(sys.executable, "-m", "venv", "--clear", VENV)
    return str(VENV)


def current_stamp(extras: Sequence[str]) -> dict[str, object]:
    """Describe an installation of the extras from pyproject.toml and constraints.txt as they are now."""
    content = (ROOT / "pyproject.toml").read_bytes() + CONSTRAINTS.read_bytes()
    return {"requirements": hashlib.sha256(content).hexdigest(), "extras": sorted(extras)}


def is_installed(extras: Sequence[str]) -> bool:
    """Return True if the extras are installed from pyproject.toml and constraints.txt as they are now."""
    try:
        stamp = json.loads(STAMP.read_text())
    except (FileNotFoundError, json.JSONDecodeError):
        return False
    current = current_stamp(extras)
    unchanged = stamp.get("requirements") == current["requirements"]
    return PYTHON.exists() and unchanged and set(extras) <= set(stamp["extras"])


def install_project(extras: Sequence[str]) -> str:
    """Install the checkout with these extras, editable, into the virtual environment.

    uv does it in a tenth of pip's time. It does not read pip's configuration, so pip takes over where uv fails, for
    example because packages come from an index of the company.
    """
    project = ("-e", f"{ROOT}[{','.join(extras)}]")
    pip_install(PYTHON, "uv")
    try:
        run(PYTHON, "-m", "uv", "pip", "install", "--python", PYTHON, *UV_OPTIONS, *project)
    except ProvisioningError:
        pip_install(PYTHON, *project)
    STAMP.write_text(json.dumps(current_stamp(extras)))
    return f"rce[{','.join(extras)}]"


def build_typesupport(packages: Sequence[Path]) -> str:
    """Build type support of RCE's own interface packages and of these, and return the builder's last line."""
    if shutil.which("g++") is None or not (Path(sysconfig.get_path("include")) / "Python.h").exists():
        return "skipped: needs g++ and Python's headers"
    return run(PYTHON, "-P", "-m", "provisioning.typesupport", *packages).strip().splitlines()[-1]


def compile_kernels(tests: bool) -> str:
    """Compile the Numba kernels that are needed, so that neither the demo nor each process of the tests has to wait."""
    modules = ["rce.mapping.mappers", *(KERNELS_OF_TESTS if tests else [])]
    run(PYTHON, "-P", "-c", f"import {', '.join(modules)}", environment=KEEP_BYTECODE)
    return f"kernels of {' and '.join(modules)}"


def install_steps(extras: Sequence[str], tests: bool) -> list[Step]:
    """Return the steps that make a virtual environment with RCE in it."""
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
    """Return the steps that install RCE and build the types of its messages."""
    types = Step("type support", lambda: "build what is not in its cache yet", lambda: build_typesupport(packages))
    kernels = Step("kernels", lambda: "compile what is not in its cache yet", lambda: compile_kernels(tests))
    return [*install_steps(extras, tests), types, kernels]


# --- PostgreSQL for the tests -----------------------------------------------------------------------------------------


def postgresql_program(name: str) -> str | None:
    """Find a program of PostgreSQL, the newest version's. Debian keeps them off PATH, by version."""
    return shutil.which(name) or next(iter(sorted(glob.glob(f"/usr/lib/postgresql/*/bin/{name}"), reverse=True)), None)


def has_user(name: str) -> bool:
    """Return True if this system has a user of this name."""
    return any(user.pw_name == name for user in pwd.getpwall())


@contextlib.contextmanager
def postgresql() -> Iterator[dict[str, str]]:
    """Run a private PostgreSQL; yields the environment variable by which the tests find it, if there is PostgreSQL.

    It listens on a socket in its own directory only. As PostgreSQL refuses to run as root, root runs it as the user
    `postgres`, whom its package creates.
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
    """Install RCE and map a building with it: a simulated one, or the recording of --log."""
    source = [str(options.log.resolve())] if options.log else ["--simulate"]
    command = [str(VENV / "bin" / "rce"), "map", *source, "--out", str(options.out.resolve()), *rest]
    steps = setup_steps(DEMO_EXTRAS, [], tests=False)
    if options.dry_run:
        print_plan(steps, command)
        return 0
    start_log()
    run_steps(steps)
    return run_in_foreground(command)


def test(options: argparse.Namespace, rest: list[str]) -> int:
    """Install all that the tests need, check code and types, then test; further arguments go to pytest."""
    steps = [
        *setup_steps(TEST_EXTRAS, [TEST_PACKAGE], tests=True),
        *([] if options.rest else check_steps()),
    ]
    commands = pytest_commands(options, rest)
    if options.dry_run:
        print_plan(steps, *commands)
        return 0
    start_log()
    run_steps(steps)
    with postgresql() as variables:
        for command in commands:
            status = run_in_foreground(command, cwd=ROOT, environment=KEEP_BYTECODE | variables)
            if status:
                return status
    return 0


def check_steps() -> list[Step]:
    """Return the steps that check code and types."""
    tool = VENV / "bin"
    return [
        check_step("ruff check", tool / "ruff", "check", ".", SCRIPT),
        check_step("ruff format", tool / "ruff", "format", "--check", ".", SCRIPT),
        check_step("mypy", tool / "mypy", "--num-workers", "2"),
        check_step("mypy provision", tool / "mypy", "--scripts-are-modules", SCRIPT),
    ]


def pytest_commands(options: argparse.Namespace, rest: Sequence[str]) -> list[list[str]]:
    """Return the runs of pytest: quick tests first, then the others. With arguments of the user's it is one run."""
    pytest = [str(PYTHON), "-m", "pytest", *IN_TWO_PROCESSES]
    quick = [*pytest, *QUICK, *rest]
    others = [*pytest, *REST, *rest]
    if options.quick:
        return [quick]
    if options.rest:
        return [others]
    return [[*pytest, *rest]] if rest else [quick, others]


def image(options: argparse.Namespace, rest: list[str]) -> int:
    """Build the images of environments for the engine docker, by the daemon at DOCKER_HOST or the local one."""
    command = [str(PYTHON), "-P", "-m", "provisioning.image", *rest]
    steps = install_steps(IMAGE_EXTRAS, tests=False)
    if options.dry_run:
        print_plan(steps, command)
        return 0
    start_log()
    run_steps(steps)
    return run_in_foreground(command, cwd=ROOT)


def add_commands(commands: Commands) -> None:
    """Add the subcommands of this module."""
    command = add_command(commands, demo, passes_on=True)
    command.add_argument("--log", type=Path, metavar="FILE", help="map this recording: CARMEN log or ROS bag")
    command.add_argument("--out", type=Path, default=Path("rce-demo"), metavar="DIR", help="default: %(default)s")
    command = add_command(commands, test, passes_on=True)
    stages = command.add_mutually_exclusive_group()
    stages.add_argument(
        "--quick", action="store_true", help="only checks and quick tests: no whole platforms, no Docker"
    )
    stages.add_argument(
        "--rest", action="store_true", help="only the tests that --quick leaves out, without the checks"
    )
    add_command(commands, image, passes_on=True)


def run_in_foreground(
    command: Sequence[str], cwd: Path | None = None, environment: dict[str, str] | None = None
) -> int:
    """Run a program that uses the terminal, and return its exit status."""
    program = subprocess.Popen(command, cwd=cwd, env={**os.environ, **(environment or {})})
    try:
        while True:
            with contextlib.suppress(KeyboardInterrupt):  # the terminal interrupts the program too, which cleans up
                return program.wait()
    finally:
        program.terminate()
        program.wait()
