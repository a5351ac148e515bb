"""Summary at the end of `install`: ports to open, and the next steps. Standard library only."""

from __future__ import annotations

from provisioning import configuration, units
from provisioning.configuration import Installation
from provisioning.services import PASSWORD, START_ORDER, as_user
from provisioning.steps import ProvisioningError
from provisioning.system import CURRENT, TLS, VAR, System, unit

Port = tuple[int, str, str]


def ports(installation: Installation) -> list[Port]:
    """Return the listening ports: number, who connects to it, and its purpose."""
    http = int(installation.option("http_port", str(configuration.HTTP_PORT)))
    ws = int(installation.option("ws_port", str(configuration.WS_PORT)))
    found: list[Port] = []
    if "master" in installation.roles:
        found += [
            (http, "robots", "robots' entry (https)"),
            (configuration.CONTROL_PORT, "machines", "control connections (TLS)"),
            (configuration.MACHINES_PORT, "machines", "new machines join (https)"),
            *((port, "clients", f"{name.replace('-', ' ')} (https)") for name, port in configuration.WEB_PORTS.items()),
        ]
    if "robot" in installation.roles:
        found += [
            (ws, "robots", "robots' WebSockets (wss)"),
            (configuration.DATA_PORTS["robot"], "machines", "data between machines (TLS)"),
        ]
    if "container" in installation.roles:
        found.append((configuration.DATA_PORTS["container"], "machines", "data between machines (TLS)"))
    return found


def firewall_ports(installation: Installation) -> str:
    """Return a list of the ports to open in a firewall."""
    lines = ["Ports to open in a firewall, all TCP; other ports need not be reachable from outside:"]
    return "\n".join(lines + [f"  {port:<6} from {peer:<9} {purpose}" for port, peer, purpose in ports(installation)])


def next_steps(system: System, installation: Installation) -> str:
    """Return what to do after `install`."""
    parts = [firewall_ports(installation)]
    if not system.runs_systemd():
        commands = [units.command(role, installation.engine) for role in START_ORDER if role in installation.roles]
        parts.append("systemd does not run here. Start the services by hand, each in its own terminal:")
        parts[-1] += "".join(f"\n  {command}" for command in commands)
    else:
        parts.append(f"Logs: journalctl -u {unit(installation.roles[0])} -f")
    if "master" in installation.roles:
        http = installation.option("http_port", str(configuration.HTTP_PORT))
        parts.append(f"Robots: https://{installation.address}:{http}/")
        if installation.options.get("certificate") is None:
            parts[-1] += f"; they must trust {TLS}/ca.pem (SSL_CERT_FILE), unless you install a public certificate"
        if system.path(PASSWORD).exists():
            parts.append(f"Administrator: admin; the password is in {PASSWORD}: read it and remove the file.")
        parts.append(
            f"Users: {' '.join(as_user(f'{CURRENT}/bin/rce'))} user --data-dir={VAR}/master add NAME\n"
            "Another machine: provisioning/provision machine add NAME"
        )
    parts.append("To check the installation: provisioning/provision doctor")
    return "\n\n".join(parts)


def check_ports(installation: Installation) -> None:
    """Check that no two services have the same port.

    Raises:
        ProvisioningError: They have.
    """
    seen: dict[int, str] = {}
    for port, _, purpose in ports(installation):
        if port in seen:
            raise ProvisioningError(f"port {port} is used for {seen[port]} and for {purpose}: choose another")
        seen[port] = purpose
