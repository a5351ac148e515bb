"""What `install` tells at its end: who may reach which port, and what to do next. Standard library only."""

from __future__ import annotations

from provisioning import configuration, units
from provisioning.configuration import Wanted
from provisioning.services import PASSWORD, START_ORDER, as_user
from provisioning.steps import Failed
from provisioning.system import CURRENT, TLS, VAR, System, unit

Port = tuple[int, str, str]


def ports(wanted: Wanted) -> list[Port]:
    """Number, who must reach it, and what for."""
    http = int(wanted.option("http_port", str(configuration.HTTP_PORT)))
    ws = int(wanted.option("ws_port", str(configuration.WS_PORT)))
    found: list[Port] = []
    if "master" in wanted.roles:
        found += [
            (http, "robots", "their entry (https)"),
            (configuration.CONTROL_PORT, "machines", "control connections (TLS)"),
            (configuration.MACHINES_PORT, "machines", "where new machines join (https)"),
            (configuration.MAPS_PORT, "clients", "map service (https)"),
        ]
    if "robot" in wanted.roles:
        found += [
            (ws, "robots", "their WebSockets (wss)"),
            (configuration.DATA_PORTS["robot"], "machines", "data between machines (TLS)"),
        ]
    if "container" in wanted.roles:
        found.append((configuration.DATA_PORTS["container"], "machines", "data between machines (TLS)"))
    return found


def firewall(wanted: Wanted) -> str:
    lines = ["Ports to open in a firewall, all TCP; nothing else needs to be reached from outside:"]
    return "\n".join(lines + [f"  {port:<6} from {whom:<9} {what}" for port, whom, what in ports(wanted)])


def after(system: System, wanted: Wanted) -> str:
    """The last words of `install`."""
    parts = [firewall(wanted)]
    if not system.runs_systemd():
        commands = [units.command(role, wanted.engine) for role in START_ORDER if role in wanted.roles]
        parts.append("systemd does not run here. To start the services by hand, each in a terminal of its own:")
        parts[-1] += "".join(f"\n  {command}" for command in commands)
    else:
        parts.append(f"Logs: journalctl -u {unit(wanted.roles[0])} -f")
    if "master" in wanted.roles:
        http = wanted.option("http_port", str(configuration.HTTP_PORT))
        parts.append(f"Robots: https://{wanted.address}:{http}/")
        if wanted.options.get("certificate") is None:
            parts[-1] += f"; they must trust {TLS}/ca.pem (SSL_CERT_FILE), or give this platform a public certificate"
        if system.path(PASSWORD).exists():
            parts.append(f"Administrator: admin; the password is in {PASSWORD}: remove the file when you have it.")
        parts.append(
            f"Users: {' '.join(as_user(f'{CURRENT}/bin/rce'))} user --data-dir={VAR}/master add NAME\n"
            "Another machine: provisioning/provision machine add NAME"
        )
    parts.append("Is all well? provisioning/provision doctor")
    return "\n\n".join(parts)


def check(wanted: Wanted) -> None:
    """Two services on one port would never start."""
    seen: dict[int, str] = {}
    for port, _, what in ports(wanted):
        if port in seen:
            raise Failed(f"port {port} would be for {seen[port]} and for {what}: choose another")
        seen[port] = what
