"""Queries of the system that RCE is installed on."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from provisioning import system as module
from provisioning.steps import ProvisioningError
from provisioning.system import System


@pytest.fixture
def system(tmp_path: Path) -> System:
    (tmp_path / "etc").mkdir()
    return System(tmp_path)


def test_paths_are_below_the_root(system: System) -> None:
    assert system.path("/etc/rce/tls") == system.root / "etc/rce/tls"
    assert System().path("/etc/rce") == Path("/etc/rce")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('NAME="Debian GNU/Linux"\nID=debian\nVERSION_ID="12"\n', ("debian", "12")),
        ("VERSION_ID=24.04\nID=ubuntu\n", ("ubuntu", "24.04")),
        ("ID=arch\n# it has no version\n\n", ("arch", "")),
        ("", ("", "")),
    ],
)
def test_name_and_version_of_the_distribution(system: System, text: str, expected: tuple[str, str]) -> None:
    system.path("/etc/os-release").write_text(text)
    assert system.release() == expected


def test_system_without_files(system: System) -> None:
    assert system.release() == ("", "")
    assert not system.has_user()
    assert not system.runs_systemd()
    assert not system.has_program("dockerd")
    assert system.text("/etc/passwd") == ""
    assert system.roles() == ()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("rce:x:999:999::/:/bin/false\n", True),
        ("root:x:0:0::/:/bin/sh\nrce:x:999:999::/:/bin/false\n", True),
        ("source:x:1:1::/:/bin/sh\nrce2:x:2:2::/:/bin/sh\n", False),
    ],
)
def test_user_of_the_services(system: System, text: str, expected: bool) -> None:
    system.path("/etc/passwd").write_text(text)
    assert system.has_user() is expected


def test_programs_are_in_the_usual_directories(system: System) -> None:
    for place in ("usr/sbin", "usr/local/bin"):
        (system.root / place).mkdir(parents=True)
    system.path("/usr/sbin/dockerd").touch()
    system.path("/usr/local/bin/docker").touch()
    assert system.has_program("dockerd")
    assert system.has_program("docker")
    assert not system.has_program("iptables")


def test_newest_supported_python_is_used(system: System) -> None:
    system.path("/usr/bin").mkdir(parents=True)
    assert system.python() == "/usr/bin/python3"
    for minor in (10, 11, 13, 14):
        system.path(f"/usr/bin/python3.{minor}").touch()
    assert system.python() == "/usr/bin/python3.13"


def test_roles_are_those_with_settings(system: System) -> None:
    system.path("/etc/rce").mkdir()
    for name in ("map-service.toml", "robot.toml", "other.toml"):
        system.path(f"/etc/rce/{name}").touch()
    assert system.roles() == ("robot", "map-service")


def test_content_is_compared(system: System) -> None:
    assert not system.file_is("/etc/a", "")
    system.path("/etc/a").write_text("a")
    assert system.file_is("/etc/a", "a")
    assert not system.file_is("/etc/a", "b")


@pytest.fixture
def owners(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """Owners that files would have been given."""
    given: list[tuple[str, str]] = []

    def own(path: Path, user: str, group: str, mode: int) -> None:
        given.append((user, group))
        path.chmod(mode)

    monkeypatch.setattr(module, "own", own)
    return given


def test_file_is_replaced_and_has_its_mode(system: System, owners: list[tuple[str, str]]) -> None:
    system.path("/etc/.a.new").write_text("left over by a program that was killed")
    for text in ("one", "two"):
        system.write("/etc/a", text, 0o640, "rce")
        assert system.text("/etc/a") == text
    assert system.path("/etc/a").stat().st_mode & 0o777 == 0o640
    assert owners == [("root", "rce")] * 2
    assert [path.name for path in system.path("/etc").iterdir()] == ["a"]


def test_secret_is_never_readable_to_others(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    modes: list[int] = []
    monkeypatch.setattr(module, "own", lambda path, *_: modes.append(path.stat().st_mode & 0o777))
    before = os.umask(0)
    try:
        system.write("/etc/key", "secret", 0o600)
    finally:
        os.umask(before)
    assert modes == [0o600]


def test_failed_write_keeps_the_former_file(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    system.path("/etc/a").write_text("one")

    def fail(*_: object) -> None:
        raise KeyError("getgrnam(): name not found: 'rce'")

    monkeypatch.setattr(module, "own", fail)
    with pytest.raises(KeyError):
        system.write("/etc/a", "two", 0o640, "rce")
    assert system.text("/etc/a") == "one"


def test_python_that_others_cannot_run_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "home"
    home.mkdir(mode=0o700)
    (home / "python").touch(mode=0o755)
    monkeypatch.setattr(sys, "executable", str(home / "python"))
    exists = Path.exists
    monkeypatch.setattr(Path, "exists", lambda path: exists(path) and not str(path).startswith("/usr/bin/"))
    with pytest.raises(ProvisioningError, match=r"other users cannot run .*home/python: apt-get install"):
        module.public_python()


def test_address_towards_another_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    assert module.own_address("127.0.0.1") == "127.0.0.1"
    assert module.own_address("255.255.255.255") == "127.0.0.1", "a broadcast address has no route"


def test_docker_that_is_missing_or_fails_does_not_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "program", lambda name: None)
    assert not module.docker_answers()
    for program, expected in (("/bin/true", True), ("/bin/false", False)):
        monkeypatch.setattr(module, "program", lambda name, program=program: program)
        assert module.docker_answers() is expected
