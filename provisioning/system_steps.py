"""First steps of `install`: packages, the user and its directories, certificates. Standard library only."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection
from pathlib import Path

from provisioning import configuration
from provisioning.configuration import MEMBERSHIP, Installation
from provisioning.release import python_has
from provisioning.steps import ProvisioningError, Step, run
from provisioning.system import AUTHORITY_KEY, CURRENT, ETC, OPT, TLS, USER, VAR, System, own, program

PYTHON = f"{CURRENT}/bin/python"
QUIET = {"DEBIAN_FRONTEND": "noninteractive"}


# --- packages ---------------------------------------------------------------------------------------------------------


def missing_packages(system: System, installation: Installation) -> list[str]:
    """Return the Debian packages that the system lacks."""
    python = system.python()
    name = Path(python).name
    needed: dict[str, bool] = {
        f"{name}-venv": _has_venv(system, python),
        "ca-certificates": system.path("/etc/ssl/certs/ca-certificates.crt").exists(),
    }
    if "container" in installation.roles and installation.uses_docker:
        programs = {"docker.io": "dockerd", "iptables": "iptables", "debootstrap": "debootstrap"}
        needed |= {package: system.has_program(program) for package, program in programs.items()}
    elif "container" in installation.roles:
        headers = system.path(f"/usr/include/{name}/Python.h").exists() or not python.startswith("/usr/bin/")
        needed |= {"g++": system.has_program("g++"), f"{name}-dev": headers}
    return [package for package, present in needed.items() if not present]


def _has_venv(system: System, python: str) -> bool:
    """Return True if this Python makes virtual environments; Debian ships that separately."""
    if python.startswith("/usr/bin/"):
        return system.path(f"/usr/lib/{Path(python).name}/ensurepip/__init__.py").exists()
    return python_has(python, "ensurepip")


def package_step(system: System, installation: Installation) -> Step:
    """Return the step that installs missing Debian packages."""
    missing = missing_packages(system, installation)
    return Step("system packages", lambda: " ".join(missing), lambda: install_packages(missing))


def install_packages(packages: list[str]) -> str:
    """Install Debian packages.

    Raises:
        ProvisioningError: This system has no apt-get, or it failed.
    """
    if program("apt-get") is None:
        raise ProvisioningError(f"there is no apt-get here: install {', '.join(packages)} by hand")
    run("apt-get", "update", environment=QUIET)
    run("apt-get", "install", "-y", "--no-install-recommends", *packages, environment=QUIET)
    return f"installed {' '.join(packages)}"


# --- user and directories ---------------------------------------------------------------------------------------------


def account_steps(system: System, roles: Collection[str]) -> list[Step]:
    """Return the steps that make the user of all services and their directories."""

    def add_user() -> str:
        run(program("useradd") or "useradd", "--system", "--user-group", "--home-dir", VAR, "--no-create-home",
            "--shell", "/usr/sbin/nologin", USER)  # fmt: skip
        return USER

    places = {ETC: ("root", "root", 0o755), OPT: ("root", "root", 0o755), VAR: ("root", "root", 0o755)}
    places |= {TLS: ("root", USER, 0o750), str(Path(AUTHORITY_KEY).parent): ("root", USER, 0o750)}
    places |= {f"{VAR}/{role}": (USER, USER, 0o700) for role in roles}
    missing = [place for place in places if not system.path(place).is_dir()]

    def make() -> str:
        for place in missing:
            system.path(place).mkdir(parents=True)
            own(system.path(place), *places[place])
        return " ".join(missing)

    return [
        Step("user", lambda: "" if system.has_user() else f"system user {USER}, without login", add_user),
        Step("directories", lambda: " ".join(missing), make),
    ]


# --- certificates -----------------------------------------------------------------------------------------------------


def certificate_step(system: System, installation: Installation) -> Step:
    """Return the step that gets this machine's certificate, from a new CA here or from the Master that it joins."""
    words = (PYTHON, "-P", "-m", "provisioning.identity", "--directory", TLS)

    def make() -> str:
        hosts = list(dict.fromkeys((installation.address, installation.name, "localhost", "127.0.0.1")))
        remark = run(*words, "make", "--authority-key", AUTHORITY_KEY, installation.name, *hosts)
        own(system.path(AUTHORITY_KEY), "root", USER, 0o640)
        own(system.path(f"{TLS}/key.pem"), "root", USER, 0o640)
        return remark.strip()

    def join() -> str:
        assert installation.code is not None
        answer = run(*words, "join", secret=installation.code.text)
        own(system.path(f"{TLS}/key.pem"), "root", USER, 0o640)
        membership = json.loads(answer) | {"joined_with": _digest(installation.code.text)}
        del membership["certificate"]
        system.write(MEMBERSHIP, json.dumps(membership), 0o600)
        return f"joined {installation.code.url} as {installation.code.name}"

    if installation.code is not None:
        membership = configuration.read_membership(system)
        done = membership.get("joined_with") == _digest(installation.code.text)
        todo = (
            ""
            if done
            else f"make a key and get a certificate for {installation.code.name} from {installation.code.url}"
        )
        return Step("certificates", lambda: todo, join)
    if "master" not in installation.roles:
        return Step("certificates", lambda: "", make)  # this machine has joined before
    return Step("certificates", lambda: f"a CA and a certificate for {installation.address}, unless they exist", make)


def _digest(code: str) -> str:
    """Return a hash of a join code, by which it is recognized without being stored."""
    return hashlib.sha256(code.encode()).hexdigest()
