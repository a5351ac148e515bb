"""Command `doctor`: checks everything that the platform needs on this machine. Standard library only."""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import socket
import ssl
import subprocess
import time
from collections.abc import Iterator
from dataclasses import asdict
from email.utils import parsedate_to_datetime
from typing import TYPE_CHECKING, Any

from provisioning import configuration, findings, release, units
from provisioning.findings import Finding, judge
from provisioning.services import receive_buffer
from provisioning.steps import ProvisioningError, add_command
from provisioning.system import CURRENT, ETC, KNOWN, TLS, UNITS, USER, VAR, System, unit

if TYPE_CHECKING:
    from provisioning.steps import Commands

INSTALL = "provisioning/provision install"
TIMEOUT = 5.0  # seconds for an answer over the network
SHARED_MEMORY = 256e6
IMPORTS = {
    "master": "master.service",
    "robot": "endpoints.robot.server",
    "container": "containers.taskset",
    "map-service": "rce.mapservice.server",
    "knowledge-service": "rce.knowledge.server",
}


def doctor(options: argparse.Namespace, rest: list[str]) -> int:
    """Check this machine, and say what to do. The exit status is 1 if a finding is bad, else 0."""
    found = []
    for finding in examine(System()):
        found.append(finding)
        if not options.json:
            print(finding.line(), flush=True)
    if options.json:
        print(json.dumps([asdict(finding) for finding in found], indent=2))
    return int(findings.worst(found) == "bad")


def add_commands(commands: Commands) -> None:
    """Add the subcommand `doctor`."""
    command = add_command(commands, doctor)
    command.add_argument("--json", action="store_true", help="print the findings as JSON")


def examine(system: System) -> Iterator[Finding]:
    """Check everything."""
    yield judge(
        system.release() in KNOWN, "system", " ".join(system.release()) or "unknown", "see docs/operations.md", "warn"
    )
    roles = system.roles()
    if not roles:
        yield Finding("bad", "installation", "nothing is installed", INSTALL)
        return
    try:
        settings = {role: configuration.read(system, role) for role in roles}
    except ProvisioningError as error:
        yield Finding("bad", "settings", str(error))
        return
    yield from _installation(system, roles, settings)
    yield from _services(system, roles, settings)
    yield from _certificates(system, roles)
    yield from _master(system, settings)
    yield from _machine(system)
    container = settings.get("container", {})
    if container.get("engine") in ("docker", "swarm"):
        yield from _docker(str(container.get("image", "")))
    elif container:
        yield from _process_engine(system)


def _installation(
    system: System, roles: tuple[str, ...], settings: dict[str, configuration.Settings]
) -> Iterator[Finding]:
    python = system.path(f"{CURRENT}/bin/python")
    version = _output(str(python), "-c", "import sys; print(*sys.version_info[:3], sep='.')")
    yield judge(bool(version), "python", version or f"{python} does not run", INSTALL)
    broken = [role for role in roles if version and not _runs(str(python), "-P", "-c", f"import {IMPORTS[role]}")]
    found = f"{', '.join(broken)} cannot be imported" if broken else release.installed_release(system)
    yield judge(not broken, "packages", found, INSTALL)
    yield judge(system.has_user(), "user", USER, INSTALL)
    for role in roles:
        mode = system.path(f"{ETC}/{role}.toml").stat().st_mode & 0o777
        yield judge(
            not mode & 0o007,
            f"{role}.toml",
            f"mode {mode:o}",
            f"others can read its secrets: chmod 640 {ETC}/{role}.toml",
        )


def _services(system: System, roles: tuple[str, ...], settings: dict[str, configuration.Settings]) -> Iterator[Finding]:
    for role in roles:
        engine = str(settings.get("container", {}).get("engine", ""))
        same = system.file_is(f"{UNITS}/{unit(role)}", units.text(role, engine))
        yield judge(same, unit(role), "as installed" if same else "missing or changed", INSTALL, "warn")
        if system.runs_systemd():
            state = _output("systemctl", "is-active", unit(role)) or "not active"
            remedy = f"journalctl -u {unit(role)} -n 50 says why"
            yield judge(state == "active", unit(role), state, remedy)
    for port, what in _listening(settings):
        yield judge(_answers("127.0.0.1", port), f"port {port}", what, f"nothing listens there: {_start(system)}")


def _start(system: System) -> str:
    return "systemctl start 'rce-*'" if system.runs_systemd() else "start the services (docs/operations.md)"


def _listening(settings: dict[str, configuration.Settings]) -> Iterator[tuple[int, str]]:
    master = settings.get("master", {})
    for key, what in {"http": "robots' entry", "control": "control", "machines": "where machines join"}.items():
        found = re.match(r"\w+:(?:port=)?(\d+)", str(master.get(key, "")))
        if found and not (key == "machines" and master.get("masters")):  # of several Masters only the leader listens
            yield int(found[1]), what
    for role, key, what in (
        ("robot", "ws_port", "robots' WebSockets"),
        ("robot", "data_port", "data"),
        ("container", "data_port", "data"),
        ("map-service", "port", "maps"),
        ("knowledge-service", "port", "knowledge"),
    ):
        if port := settings.get(role, {}).get(key):
            yield int(str(port)), f"{what} ({role})"


def _certificates(system: System, roles: tuple[str, ...]) -> Iterator[Finding]:
    remedy = INSTALL if "master" in roles else "provisioning/provision machine add NAME on the Master's machine"
    for name in ("ca.pem", "cert.pem"):
        end = _end_of(system, f"{TLS}/{name}")
        if end is None:
            yield Finding("bad", name, f"{TLS}/{name} cannot be read", remedy)
        else:
            yield findings.expiry(name, end - time.time(), remedy)
    key = system.path(f"{TLS}/key.pem")
    private = key.exists() and not key.stat().st_mode & 0o007
    yield judge(
        private, "key.pem", "private" if private else "missing, or others can read it", f"chmod 640 {TLS}/key.pem"
    )


def _end_of(system: System, name: str) -> float | None:
    """Return the expiry of a certificate in seconds since 1970, or None if it cannot be read."""
    code = (
        "import sys; from rce.net.certificates import certificate_expiry as expiry; "
        "print(expiry(open(sys.argv[1]).read()))"
    )
    end = _output(str(system.path(f"{CURRENT}/bin/python")), "-P", "-c", code, str(system.path(name)))
    return float(end) if end else None


def _master(system: System, settings: dict[str, configuration.Settings]) -> Iterator[Finding]:
    """Check that services of this machine can reach the Master and trust it."""
    addresses = next((str(values["master"]) for values in settings.values() if "master" in values), "")
    for address in addresses.split(","):
        if address.startswith("tcp:"):
            yield from _master_at(system, address)


def _master_at(system: System, address: str) -> Iterator[Finding]:
    host, _, port = address.removeprefix("tcp:").rpartition(":")
    try:
        trust = ssl.create_default_context(cafile=str(system.path(f"{TLS}/ca.pem")))
        trust.load_cert_chain(system.path(f"{TLS}/cert.pem"), system.path(f"{TLS}/key.pem"))
        with (
            socket.create_connection((host, int(port)), TIMEOUT) as plain,
            trust.wrap_socket(plain, server_hostname=host) as secured,
        ):
            yield Finding("ok", "master", f"{host}:{port} answers, {secured.version()}")
    except ssl.SSLError as error:
        yield Finding(
            "bad", "master", f"{host}:{port}: {error.reason or error}", "if the Master was reinstalled, join again"
        )
    except OSError as error:
        yield Finding("bad", "master", f"{host}:{port}: {error}", "check that it runs, and its firewall")
    else:
        difference = _clock(trust, host)
        if difference is not None:
            yield findings.clock(difference)


def _clock(trust: ssl.SSLContext, host: str) -> float | None:
    """Return by how many seconds our clock is ahead of the date in a response of the Master; None without one."""
    try:
        with (
            socket.create_connection((host, configuration.MACHINES_PORT), TIMEOUT) as plain,
            trust.wrap_socket(plain, server_hostname=host) as secured,
        ):
            secured.sendall(b"GET /authority HTTP/1.0\r\n\r\n")
            answer = secured.recv(4096).decode("latin-1")
    except OSError:
        return None
    date = re.search(r"^date: *(.+?)\r?$", answer, re.MULTILINE | re.IGNORECASE)
    return time.time() - parsedate_to_datetime(date[1]).timestamp() if date else None


def _machine(system: System) -> Iterator[Finding]:
    free = shutil.disk_usage(system.path(VAR)).free
    yield findings.amount(
        "disk", f"free at {VAR}", free, 10e9, 1e9, "free space: docker system prune, journalctl --vacuum-size"
    )
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    yield findings.amount("memory", "in total", memory, 2e9, 0.5e9, "an idle environment takes about 0.1 GB")


def _process_engine(system: System) -> Iterator[Finding]:
    shared = os.statvfs("/dev/shm")
    size = shared.f_frsize * shared.f_blocks
    yield judge(size >= SHARED_MEMORY, "/dev/shm", f"{size / 1e6:.0f} MB", "mount it with size=256m or more", "warn")
    built = system.path(f"{release.TYPESUPPORT}/current").exists()
    yield judge(built, "type support", "built" if built else "missing", INSTALL)
    yield Finding(
        "warn",
        "isolation",
        "the engine process runs users' programs as this user",
        "use --engine docker unless you trust them",
    )


def _docker(image: str) -> Iterator[Finding]:
    yield findings.receive_buffer(receive_buffer())
    text = _output("docker", "info", "--format", "{{json .}}")
    info: dict[str, Any] = json.loads(text) if text.startswith("{") else {}
    if not info.get("ServerVersion"):
        yield Finding("bad", "docker", "does not answer", "systemctl start docker; its log: journalctl -u docker")
        return
    yield from findings.docker(info)
    version = _version()
    image = image or f"rce/mapping:{version}"
    label = _output("docker", "image", "inspect", image, "--format", '{{index .Config.Labels "rce.version"}}')
    found = f"{image} is of version {label}" if label else f"there is no {image}"
    yield judge(label == version, "images", found, "provisioning/provision image")


def _version() -> str:
    return _output(f"{CURRENT}/bin/python", "-P", "-c", "import rce; print(rce.__version__)")


def _answers(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), TIMEOUT).close()
    except OSError:
        return False
    return True


def _output(*command: str) -> str:
    """Return the output of a program, or "" if it fails or is missing."""
    try:
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, timeout=60)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return "" if done.returncode else done.stdout.strip()


def _runs(*command: str) -> bool:
    return subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode == 0
