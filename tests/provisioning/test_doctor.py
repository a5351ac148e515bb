"""`provision doctor`: what it finds on fake systems, and how it judges."""

from __future__ import annotations

import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from provisioning import doctor, findings, identity, units
from provisioning.findings import DAY, GB, Finding, worst
from provisioning.system import System

INFO: dict[str, object] = {
    "ServerVersion": "20.10.24+dfsg1",
    "MemoryLimit": True,
    "SwapLimit": True,
    "PidsLimit": True,
    "CpuCfsQuota": True,
    "SecurityOptions": ["name=apparmor", "name=seccomp,profile=default"],
}


@pytest.fixture
def system(tmp_path: Path) -> System:
    """Where a task set was installed, and nothing runs."""
    for place in ("etc/rce/tls", "etc/systemd/system", "var/lib/rce"):
        (tmp_path / place).mkdir(parents=True)
    (tmp_path / "etc/os-release").write_text('ID=debian\nVERSION_ID="12"\n')
    (tmp_path / "etc/passwd").write_text("rce:x:999:999::/var/lib/rce:/usr/sbin/nologin\n")
    settings = tmp_path / "etc/rce/container.toml"
    settings.write_text(f'master = "tcp:127.0.0.1:{unused_port()}"\nengine = "process"\ndata_port = {unused_port()}\n')
    settings.chmod(0o640)
    (tmp_path / "etc/systemd/system/rce-container.service").write_text(units.text("container", "process"))
    return System(tmp_path)


def unused_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def examined(system: System) -> dict[str, Finding]:
    return {finding.about: finding for finding in doctor.examine(system)}


def test_what_is_well_and_what_is_not(system: System) -> None:
    found = examined(system)
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


def test_nothing_is_installed(tmp_path: Path) -> None:
    found = examined(System(tmp_path))
    assert found["installation"].line().endswith("nothing is installed: provisioning/provision install")
    assert worst(found.values()) == "bad"


def test_secrets_that_others_can_read(system: System) -> None:
    system.path("/etc/rce/container.toml").chmod(0o644)
    assert "chmod 640" in examined(system)["container.toml"].remedy
    system.path("/etc/rce/tls/key.pem").touch(mode=0o644)
    assert examined(system)["key.pem"].level == "bad"


def test_a_unit_that_was_changed(system: System) -> None:
    system.path("/etc/systemd/system/rce-container.service").write_text("[Service]\n")
    assert examined(system)["rce-container.service"].level == "warn"


def test_settings_that_cannot_be_read(system: System) -> None:
    system.path("/etc/rce/container.toml").write_text("= nonsense")
    assert "mend it" in examined(system)["settings"].found


@pytest.fixture
def listener() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def test_a_port_that_answers(system: System, listener: int) -> None:
    settings = system.path("/etc/rce/container.toml")
    settings.write_text(f'engine = "process"\ndata_port = {listener}\n')
    assert examined(system)[f"port {listener}"].level == "ok"


def test_certificates_are_read(system: System) -> None:
    """By the Python of the release, as on a real system: here it is the tests' own."""
    tls = system.path("/etc/rce/tls")
    identity.make(tls, tls / "ca.key", "alpha", ["127.0.0.1"])
    (tls / "key.pem").chmod(0o640)
    found = examined(with_python(system))
    assert found["python"].level == found["key.pem"].level == "ok"
    assert found["cert.pem"].found == "good for 825 days"


def with_python(system: System) -> System:
    python = system.path("/opt/rce/current/bin/python")
    python.parent.mkdir(parents=True)
    python.write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    python.chmod(0o755)
    return system


@pytest.mark.parametrize(("days", "level"), [(100, "ok"), (31, "ok"), (29, "warn"), (0, "bad"), (-3, "bad")])
def test_expiry(days: float, level: str) -> None:
    assert findings.expiry("cert.pem", days * DAY, "renew").level == level


@pytest.mark.parametrize(("seconds", "level"), [(0, "ok"), (-4, "ok"), (20, "warn"), (-4000, "bad")])
def test_clocks(seconds: float, level: str) -> None:
    finding = findings.clock(seconds)
    assert finding.level == level
    assert ("behind" in finding.found) == (seconds <= 0)


@pytest.mark.parametrize(("size", "level"), [(20, "ok"), (5, "warn"), (0.5, "bad")])
def test_amounts(size: float, level: str) -> None:
    assert findings.amount("disk", "free", size * GB, 10 * GB, 1 * GB, "make room").level == level


@pytest.mark.parametrize(("most", "level"), [(4_194_304, "ok"), (212_992, "warn")])
def test_receive_buffers(most: int, level: str) -> None:
    assert findings.receive_buffer(most).level == level


def test_docker() -> None:
    assert worst(findings.docker(INFO)) == "ok"


@pytest.mark.parametrize(
    ("change", "level", "words"),
    [
        ({"ServerVersion": "19.03.1"}, "bad", "20.10 or later"),
        ({"SwapLimit": False}, "warn", "of swap are not enforced"),
        ({"PidsLimit": False, "SwapLimit": False}, "bad", "of swap, processes are not"),
        ({"SecurityOptions": []}, "bad", "seccomp"),
    ],
)
def test_a_docker_that_is_not_well(change: dict[str, object], level: str, words: str) -> None:
    found = list(findings.docker(INFO | change))
    assert worst(found) == level
    assert any(words in finding.line() for finding in found)
