"""`provision doctor` on fake systems."""

from __future__ import annotations

import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from provisioning import (
    configuration,
    doctor,
    identity,
    units,
)
from provisioning.findings import Finding, worst
from provisioning.system import System

UNUSED_PORT = 1  # tcpmux, which nobody runs


@pytest.fixture
def system(tmp_path: Path) -> System:
    """System on which a task set is installed, but does not run."""
    for place in ("etc/rce/tls", "etc/systemd/system", "var/lib/rce"):
        (tmp_path / place).mkdir(parents=True)
    (tmp_path / "etc/os-release").write_text('ID=debian\nVERSION_ID="12"\n')
    (tmp_path / "etc/passwd").write_text("rce:x:999:999::/var/lib/rce:/usr/sbin/nologin\n")
    settings = tmp_path / "etc/rce/container.toml"
    settings.write_text(f'master = "tcp:127.0.0.1:{UNUSED_PORT}"\nengine = "process"\ndata_port = {UNUSED_PORT}\n')
    settings.chmod(0o640)
    (tmp_path / "etc/systemd/system/rce-container.service").write_text(units.text("container", "process"))
    return System(tmp_path)


def findings_by_subject(system: System) -> dict[str, Finding]:
    return {finding.about: finding for finding in doctor.examine(system)}


def test_levels_on_an_installation_that_does_not_run(system: System) -> None:
    found = findings_by_subject(system)
    assert {name: finding.level for name, finding in found.items() if name not in ("disk", "memory", "/dev/shm")} == {
        "system": "ok",
        "python": "bad",
        "packages": "ok",
        "user": "ok",
        "container.toml": "ok",
        "rce-container.service": "ok",
        next(name for name in found if name.startswith("port")): "bad",
        "ca.pem": "bad",
        "cert.pem": "bad",
        "key.pem": "bad",
        "master": "bad",
        "type support": "bad",
        "isolation": "warn",
    }
    assert all(finding.remedy for finding in found.values() if finding.level != "ok")


def test_system_without_installation(tmp_path: Path) -> None:
    found = findings_by_subject(System(tmp_path))
    assert found["installation"].line().endswith("nothing is installed: provisioning/provision install")
    assert worst(found.values()) == "bad"


def test_readable_secrets_are_reported(system: System) -> None:
    system.path("/etc/rce/container.toml").chmod(0o644)
    assert "chmod 640" in findings_by_subject(system)["container.toml"].remedy
    system.path("/etc/rce/tls/key.pem").touch(mode=0o644)
    assert findings_by_subject(system)["key.pem"].level == "bad"


def test_changed_unit_is_reported(system: System) -> None:
    system.path("/etc/systemd/system/rce-container.service").write_text("[Service]\n")
    assert findings_by_subject(system)["rce-container.service"].level == "warn"


def test_malformed_settings_are_reported(system: System) -> None:
    system.path("/etc/rce/container.toml").write_text("= nonsense")
    assert "correct it" in findings_by_subject(system)["settings"].found


@pytest.fixture
def listener() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def test_listening_port_is_ok(system: System, listener: int) -> None:
    settings = system.path("/etc/rce/container.toml")
    settings.write_text(f'engine = "process"\ndata_port = {listener}\n')
    assert findings_by_subject(system)[f"port {listener}"].level == "ok"


def test_all_masters_are_asked_and_only_the_leader_listens_for_machines(system: System) -> None:
    system.path("/etc/rce/container.toml").write_text('master = "tcp:127.0.0.1:1,tcp:127.0.0.1:2"\n')
    settings: dict[str, configuration.Settings] = {"master": {"machines": "tcp:8081", "control": "tcp:8080"}}
    assert [port for port, _ in doctor._listening(settings)] == [8080, 8081]
    settings["master"]["masters"] = ["a", "b"]
    assert [port for port, _ in doctor._listening(settings)] == [8080]
    tls = system.path("/etc/rce/tls")
    identity.make(tls, tls / "ca.key", "alpha", ["127.0.0.1"])
    both = {"container": configuration.read(system, "container")}
    assert [found.found.partition(":")[2][:1] for found in doctor._master(system, both)] == ["1", "2"]


def test_certificates_are_checked(system: System) -> None:
    """They are read by the Python of the release, which here is that of the tests."""
    tls = system.path("/etc/rce/tls")
    identity.make(tls, tls / "ca.key", "alpha", ["127.0.0.1"])
    (tls / "key.pem").chmod(0o640)
    found = findings_by_subject(with_python(system))
    assert found["python"].level == found["key.pem"].level == "ok"
    assert found["cert.pem"].found == "valid for 825 days"


def with_python(system: System) -> System:
    python = system.path("/opt/rce/current/bin/python")
    python.parent.mkdir(parents=True)
    python.write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    python.chmod(0o755)
    return system
