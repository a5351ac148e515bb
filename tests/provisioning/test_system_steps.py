"""First steps of `provision install`: packages, the user, directories and certificates."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from provisioning import install
from provisioning import system_steps as module
from provisioning.configuration import MEMBERSHIP, Installation
from provisioning.steps import ProvisioningError, Step
from provisioning.system import AUTHORITY_KEY, TLS, System
from tests.support.provisioning.systems import join_code, options


class Actions:
    """Recorder of what steps do: commands, and owners of files.

    Attributes:
        answer: Output of the commands.
    """

    def __init__(self) -> None:
        self.commands: list[str] = []
        self.secrets: list[str | None] = []
        self.owners: dict[str, tuple[str, str, int]] = {}
        self.answer = ""

    def run(self, *words: object, environment: object = None, secret: str | None = None) -> str:
        self.commands.append(" ".join(map(str, words)))
        self.secrets.append(secret)
        return self.answer

    def own(self, path: Path, user: str, group: str, mode: int) -> None:
        self.owners[str(path)] = user, group, mode


@pytest.fixture
def actions(monkeypatch: pytest.MonkeyPatch) -> Actions:
    actions = Actions()
    monkeypatch.setattr(module, "run", actions.run)
    monkeypatch.setattr(module, "own", actions.own)
    monkeypatch.setattr("provisioning.system.own", actions.own)
    monkeypatch.setattr(module, "program", lambda name: f"/usr/sbin/{name}")
    return actions


def installation(system: System, *words: str) -> Installation:
    return install.planned_installation(options("--name", "alpha", "--address", "10.0.0.1", *words), system)


def test_only_missing_packages_are_installed(debian: System) -> None:
    given = installation(debian)
    assert module.missing_packages(debian, given) == ["python3.11-venv", "docker.io", "iptables", "debootstrap"]
    for name in ("lib/python3.11/ensurepip/__init__.py", "sbin/iptables", "sbin/dockerd"):
        debian.path(f"/usr/{name}").parent.mkdir(parents=True, exist_ok=True)
        debian.path(f"/usr/{name}").touch()
    assert module.missing_packages(debian, given) == ["debootstrap"]


def test_engine_process_needs_a_compiler_instead_of_docker(debian: System) -> None:
    given = installation(debian, "--engine", "process")
    assert module.missing_packages(debian, given) == ["python3.11-venv", "g++", "python3.11-dev"]


def test_machine_without_environments_needs_neither(debian: System) -> None:
    debian.path("/etc/ssl/certs/ca-certificates.crt").unlink()
    given = installation(debian, "--role", "master")
    assert module.missing_packages(debian, given) == ["python3.11-venv", "ca-certificates"]


def test_packages_are_installed_after_an_update(debian: System, actions: Actions) -> None:
    step = module.package_step(debian, installation(debian, "--role", "master"))
    assert (step.todo(), step.action()) == ("python3.11-venv", "installed python3.11-venv")
    assert [command.split()[:2] for command in actions.commands] == [["apt-get", "update"], ["apt-get", "install"]]
    assert actions.commands[-1].endswith(" python3.11-venv")


def test_system_without_apt_is_told_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "program", lambda name: None)
    with pytest.raises(ProvisioningError, match=r"install docker\.io, iptables by hand"):
        module.install_packages(["docker.io", "iptables"])


def steps_of(system: System, *roles: str) -> dict[str, Step]:
    return {step.name: step for step in module.account_steps(system, roles)}


def test_user_is_added_once(debian: System, actions: Actions) -> None:
    step = steps_of(debian)["user"]
    assert step.todo()
    step.action()
    assert actions.commands[0].startswith("/usr/sbin/useradd --system")
    assert "--shell /usr/sbin/nologin rce" in actions.commands[0]
    debian.path("/etc/passwd").write_text("rce:x:999:999::/:/usr/sbin/nologin\n")
    assert step.todo() == ""


def test_data_of_a_role_is_private_to_the_user_and_keys_are_readable_to_it(debian: System, actions: Actions) -> None:
    step = steps_of(debian, "master", "robot")["directories"]
    step.action()
    found = {str(Path("/") / Path(path).relative_to(debian.root)): owner for path, owner in actions.owners.items()}
    assert found == {
        "/opt/rce": ("root", "root", 0o755),
        "/var/lib/rce": ("root", "root", 0o755),
        TLS: ("root", "rce", 0o750),
        "/etc/rce/authority": ("root", "rce", 0o750),
        "/var/lib/rce/master": ("rce", "rce", 0o700),
        "/var/lib/rce/robot": ("rce", "rce", 0o700),
    }, "/etc/rce exists already"
    assert steps_of(debian, "master", "robot")["directories"].todo() == ""
    assert steps_of(debian, "container")["directories"].todo() == "/var/lib/rce/container"


def test_master_makes_a_certificate_for_its_addresses(debian: System, actions: Actions) -> None:
    step = module.certificate_step(debian, installation(debian))
    assert "10.0.0.1" in step.todo()
    actions.answer = "made\n"
    assert step.action() == "made"
    (command,) = actions.commands
    assert command.endswith(f"make --authority-key {AUTHORITY_KEY} alpha 10.0.0.1 alpha localhost 127.0.0.1")
    for name in (AUTHORITY_KEY, f"{TLS}/key.pem"):
        assert actions.owners[str(debian.path(name))] == ("root", "rce", 0o640)


def test_address_is_named_once_in_the_certificate(debian: System, actions: Actions) -> None:
    given = install.planned_installation(options("--name", "alpha", "--address", "localhost"), debian)
    module.certificate_step(debian, given).action()
    assert actions.commands[0].endswith(" alpha localhost alpha 127.0.0.1")


def test_joining_machine_keeps_its_membership_but_not_the_code(debian: System, actions: Actions) -> None:
    code = join_code("container")
    step = module.certificate_step(debian, installation(debian, "--join", code))
    assert "for beta from https://10.0.0.1:8081/" in step.todo()
    actions.answer = json.dumps({"master": "10.0.0.1:8080", "certificate": "abc"})
    assert step.action() == "joined https://10.0.0.1:8081/ as beta"
    assert actions.secrets == [code], "a command line is visible to all users"
    assert code not in actions.commands[0]
    membership = json.loads(debian.text(MEMBERSHIP))
    assert membership.keys() == {"master", "joined_with"}
    assert code not in debian.text(MEMBERSHIP)
    assert actions.owners[str(debian.path(f"{TLS}/key.pem"))] == ("root", "rce", 0o640)


def test_code_is_used_once(debian: System, actions: Actions) -> None:
    given = installation(debian, "--join", join_code("container"))
    actions.answer = json.dumps({"master": "10.0.0.1:8080", "certificate": "abc"})
    module.certificate_step(debian, given).action()
    assert module.certificate_step(debian, given).todo() == ""
    other = installation(debian, "--join", join_code("robot", "container"))
    assert module.certificate_step(debian, other).todo()
