"""Command `swarm`: sets up Docker Swarm on several machines, for the engine `swarm`. Standard library only."""

from __future__ import annotations

import argparse
import json
import shlex
import socket
from typing import TYPE_CHECKING

from provisioning.services import docker_steps
from provisioning.steps import ProvisioningError, Step, add_command, need_root, print_plan, run, run_steps, start_log
from provisioning.system import System, docker_answers, own_address
from provisioning.system_steps import install_packages

if TYPE_CHECKING:
    from provisioning.steps import Commands

SETTINGS = "/etc/docker/daemon.json"
DAEMON_SETTINGS: dict[str, object] = {  # services of Swarm have no such options
    "no-new-privileges": True,
    "log-driver": "json-file",
    "log-opts": {"max-size": "2m", "max-file": "2"},
}
PROGRAMS = {"docker.io": "dockerd", "iptables": "iptables"}
FEATURE = "rce.feature."
PORTS = """\
Ports to open in a firewall between the machines of the swarm, and to nobody else:
  2377 TCP       to the manager
  7946 TCP, UDP  between all
  30000-65535 TCP to the manager: agents and images (the two ports are in swarm.json of the task set's directory)
  4789 UDP       between all (networks of environments; not encrypted, so use a network of your own for it)"""


def swarm(options: argparse.Namespace, rest: list[str]) -> int:
    """Set up a swarm: `init` makes this machine its manager, `join` a member; `label NODE` gives a node features."""
    if options.action == "label":
        return _label(options)
    system = System()
    steps = swarm_steps(system, options)
    if options.dry_run:
        print_plan(steps)
        print("\n" + PORTS)
        return 0
    need_root("swarm")
    start_log()
    run_steps(steps)
    print("\n" + PORTS)
    if options.action == "init" and docker_answers():
        token = run("docker", "swarm", "join-token", "-q", "worker").strip()
        place = f"{swarm_state()[1] or options.address}:2377"
        print("\nOn every other machine, as root (keep the token secret: it admits any machine):\n")
        print(f"provisioning/provision swarm join {place} --token {token}")
        print("\nThe task set here: provisioning/provision install --role container --engine swarm …")
    elif options.action == "join":
        words = " ".join(f"--feature {name}" for name in options.feature) or "--feature NAME"
        print(
            f"\nTo give it features, at the manager: provisioning/provision swarm label {socket.gethostname()} {words}"
        )
    return 0


def add_commands(commands: Commands) -> None:
    """Add the subcommand `swarm`."""
    command = add_command(commands, swarm)
    command.add_argument("action", choices=["init", "join", "label"])
    command.add_argument("place", nargs="?", help="join: the manager's HOST:PORT; label: the node's name")
    command.add_argument("--token", help="join: the token that `swarm init` printed")
    command.add_argument("--address", metavar="HOST", help="address of this machine for the others (default: its own)")
    command.add_argument("--feature", action="append", default=[], metavar="NAME", help="special feature of a node")


def swarm_steps(system: System, options: argparse.Namespace) -> list[Step]:
    """Return the steps that install and set up Docker and enter the swarm.

    Raises:
        ProvisioningError: Options are missing, or Docker's settings do not allow a swarm.
    """
    if options.action == "join" and not (options.place and options.token):
        raise ProvisioningError(
            "swarm join needs the manager's HOST:PORT and --token: copy the line that `swarm init` printed"
        )
    address = options.address or own_address(*([options.place.rpartition(":")[0]] if options.place else []))
    missing = [package for package, name in PROGRAMS.items() if not system.has_program(name)]
    if options.action == "init":
        command = ["docker", "swarm", "init", "--advertise-addr", address]
    else:
        command = [
            "docker",
            "swarm",
            "join",
            "--advertise-addr",
            address,
            "--token",
            options.token or "",
            options.place,
        ]
    shown = shlex.join(word if word != options.token else "…" for word in command)

    def enter() -> str:
        if not docker_answers():
            return "skipped: Docker does not answer; start dockerd and run this again"
        run(*command, secret="")
        return f"{options.action}, as {address}"

    active = docker_answers() and swarm_state()[0] == "active"
    return [
        Step("system packages", lambda: " ".join(missing), lambda: install_packages(missing)),
        _settings_step(system, options.place.rpartition(":")[0] if options.place else address),
        *docker_steps(system),
        Step("swarm", lambda: "" if active else shown, enter),
    ]


def _settings_step(system: System, manager: str) -> Step:
    """Return the step that adds our settings to those of Docker's daemon.

    Nodes pull images from the task set at the manager, by digest. So Docker need not verify its certificate
    (`insecure-registries`).
    """
    try:
        present: dict[str, object] = json.loads(system.text(SETTINGS) or "{}")
    except json.JSONDecodeError as error:
        raise ProvisioningError(f"{SETTINGS}: {error}; correct it first") from None
    if present.get("live-restore"):
        raise ProvisioningError(f"{SETTINGS} has live-restore, with which Docker refuses a swarm: remove it first")
    registries = present.get("insecure-registries", [])
    if not isinstance(registries, list):
        raise ProvisioningError(f"{SETTINGS}: insecure-registries is not a list; correct it first")
    registry = f"{socket.gethostbyname(manager)}/32"
    changed = present | DAEMON_SETTINGS | {"insecure-registries": sorted({*registries, registry})}

    def write() -> str:
        system.path(SETTINGS).parent.mkdir(parents=True, exist_ok=True)
        system.write(SETTINGS, json.dumps(changed, indent=2) + "\n", 0o644)
        if system.runs_systemd() and docker_answers():
            run("systemctl", "restart", "docker.service")
        return SETTINGS

    todo = "" if changed == present else f"{SETTINGS}: {', '.join([*DAEMON_SETTINGS, 'insecure-registries'])}"
    return Step("docker settings", lambda: todo, write)


def swarm_state() -> tuple[str, str]:
    """Return this machine's state in a swarm, such as `active`, and its address there, as Docker reports them."""
    output = run("docker", "info", "--format", "{{.Swarm.LocalNodeState}} {{.Swarm.NodeAddr}}")
    state, _, address = output.strip().partition(" ")
    return state, address


def _label(options: argparse.Namespace) -> int:
    if not options.place or not options.feature:
        raise ProvisioningError("swarm label needs the node's name (docker node ls) and --feature NAME")
    labels = [word for name in options.feature for word in ("--label-add", f"{FEATURE}{name}=true")]
    command = ["docker", "node", "update", *labels, options.place]
    if options.dry_run:
        print(f"{'run':<16} {shlex.join(command)}")
        return 0
    start_log()
    run(*command)
    print(f"{options.place}: {', '.join(options.feature)}")
    return 0
