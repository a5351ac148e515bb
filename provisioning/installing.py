"""The first steps of `install`: packages, the user and its directories, certificates. Standard library only."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection
from pathlib import Path

from provisioning import configuration
from provisioning.configuration import MEMBERSHIP, Wanted
from provisioning.release import python_has
from provisioning.steps import Failed, Step, run
from provisioning.system import AUTHORITY_KEY, CURRENT, ETC, OPT, TLS, USER, VAR, System, own, program

PYTHON = f"{CURRENT}/bin/python"
QUIET = {"DEBIAN_FRONTEND": "noninteractive"}


# --- packages ---------------------------------------------------------------------------------------------------------


def missing_packages(system: System, wanted: Wanted) -> list[str]:
    """Debian's names of what the system lacks."""
    python = system.python()
    name = Path(python).name
    needed: dict[str, bool] = {
        f"{name}-venv": _has_venv(system, python),
        "ca-certificates": system.path("/etc/ssl/certs/ca-certificates.crt").exists(),
    }
    if "container" in wanted.roles and wanted.uses_docker:
        programs = {"docker.io": "dockerd", "iptables": "iptables", "debootstrap": "debootstrap"}
        needed |= {package: system.has_program(program) for package, program in programs.items()}
    elif "container" in wanted.roles:
        headers = system.path(f"/usr/include/{name}/Python.h").exists() or not python.startswith("/usr/bin/")
        needed |= {"g++": system.has_program("g++"), f"{name}-dev": headers}
    return [package for package, present in needed.items() if not present]


def _has_venv(system: System, python: str) -> bool:
    """Debian ships Python without what makes virtual environments."""
    if python.startswith("/usr/bin/"):
        return system.path(f"/usr/lib/{Path(python).name}/ensurepip/__init__.py").exists()
    return python_has(python, "ensurepip")


def package_step(system: System, wanted: Wanted) -> Step:
    missing = missing_packages(system, wanted)
    return Step("system packages", lambda: " ".join(missing), lambda: install_packages(missing))


def install_packages(packages: list[str]) -> str:
    if program("apt-get") is None:
        raise Failed(f"install {', '.join(packages)}: there is no apt-get here to do it")
    run("apt-get", "update", environment=QUIET)
    run("apt-get", "install", "-y", "--no-install-recommends", *packages, environment=QUIET)
    return f"installed {' '.join(packages)}"


# --- user and directories ---------------------------------------------------------------------------------------------


def account_steps(system: System, roles: Collection[str]) -> list[Step]:
    """The user of all services, and the places that are theirs."""

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
        Step("user", lambda: "" if system.has_user() else f"system user {USER}, who may not log in", add_user),
        Step("directories", lambda: " ".join(missing), make),
    ]


# --- certificates -----------------------------------------------------------------------------------------------------


def certificate_step(system: System, wanted: Wanted) -> Step:
    """This machine's certificate: from an authority made on the spot, or from the Master that it joins."""
    words = (PYTHON, "-P", "-m", "provisioning.identity", "--directory", TLS)

    def make() -> str:
        hosts = list(dict.fromkeys((wanted.address, wanted.name, "localhost", "127.0.0.1")))
        remark = run(*words, "make", "--authority-key", AUTHORITY_KEY, wanted.name, *hosts)
        own(system.path(AUTHORITY_KEY), "root", USER, 0o640)
        own(system.path(f"{TLS}/key.pem"), "root", USER, 0o640)
        return remark.strip()

    def join() -> str:
        assert wanted.code is not None
        answer = run(*words, "join", secret=wanted.code.text)
        own(system.path(f"{TLS}/key.pem"), "root", USER, 0o640)
        membership = json.loads(answer) | {"joined_with": _digest(wanted.code.text)}
        del membership["certificate"]
        system.write(MEMBERSHIP, json.dumps(membership), 0o600)
        return f"joined {wanted.code.url} as {wanted.code.name}"

    if wanted.code is not None:
        membership = configuration.read_membership(system)
        done = membership.get("joined_with") == _digest(wanted.code.text)
        todo = "" if done else f"make a key, have it certified by {wanted.code.url} for {wanted.code.name}"
        return Step("certificates", lambda: todo, join)
    if "master" not in wanted.roles:
        return Step("certificates", lambda: "", make)  # of a machine that has joined
    return Step("certificates", lambda: f"an authority, and a certificate for {wanted.address}, unless there", make)


def _digest(code: str) -> str:
    """Of a join code, to know it again without keeping it."""
    return hashlib.sha256(code.encode()).hexdigest()
