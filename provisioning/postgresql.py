"""Command `postgresql`: sets up PostgreSQL on this machine for Masters. Standard library only."""

from __future__ import annotations

import argparse
import ipaddress
import secrets
from pathlib import Path
from typing import TYPE_CHECKING

from provisioning.steps import ProvisioningError, Step, add_command, need_root, print_plan, run, run_steps, start_log
from provisioning.system import System, own_address, program
from provisioning.system_steps import install_packages

if TYPE_CHECKING:
    from provisioning.steps import Commands

NAME = "rce"  # of the database and its owner
URL = "/etc/rce/postgresql.url"  # with the password
CLUSTERS = "/etc/postgresql"


def postgresql(options: argparse.Namespace, rest: list[str]) -> int:
    """Set up PostgreSQL on this machine for Masters, and print the URL for `install --database`."""
    system = System(Path("/"))
    networks = [_network(each) for each in options.allow]
    steps = setup_steps(system, options.address or own_address(), networks)
    if options.dry_run:
        print_plan(steps)
        return 0
    need_root("postgresql")
    start_log()
    run_steps(steps)
    print(f"\nThe URL for `provision install --database`, which contains the password:\n\n{system.text(URL).strip()}")
    return 0


def add_commands(commands: Commands) -> None:
    """Add the subcommand."""
    command = add_command(commands, postgresql)
    command.add_argument("--address", default="", metavar="HOST", help="address at which to listen (default: its own)")
    command.add_argument(
        "--allow", action="append", default=[], metavar="ADDRESS", help="address or network of a Master; repeated"
    )


def _network(text: str) -> str:
    try:
        return str(ipaddress.ip_network(text))
    except ValueError as error:
        raise ProvisioningError(f"--allow {text}: {error}; give an address or a network as 10.0.0.0/24") from None


def setup_steps(system: System, address: str, networks: list[str]) -> list[Step]:
    """Return the steps: the package, the database with its owner, and who may connect."""
    missing = [] if system.path(CLUSTERS).is_dir() else ["postgresql"]
    url = system.text(URL)

    def create() -> str:
        password = secrets.token_hex(24)
        _psql(f"CREATE ROLE {NAME} LOGIN PASSWORD '{password}'", f"CREATE DATABASE {NAME} OWNER {NAME}")
        host = f"[{address}]" if ":" in address else address
        system.path(URL).parent.mkdir(parents=True, exist_ok=True)
        system.write(URL, f"postgresql+psycopg://{NAME}:{password}@{host}/{NAME}\n", 0o600)
        return f"database {NAME}, its URL in {URL}"

    def admit() -> str:
        directory = cluster(system)
        settings, rules = f"{directory}/conf.d/rce.conf", f"{directory}/pg_hba.conf"
        system.write(settings, f"listen_addresses = 'localhost,{address}'\n", 0o644)
        lines = system.text(rules).splitlines()
        new = [each for each in _rules(networks) if each not in lines]
        with system.path(rules).open("a") as file:
            file.write("".join(f"{each}\n" for each in new))
        run(program("systemctl") or "systemctl", "restart", "postgresql")
        return f"at {address}"

    return [
        Step("system packages", lambda: " ".join(missing), lambda: install_packages(missing)),
        Step("database", lambda: "" if url else f"database {NAME} and its owner", create),
        Step("connections", lambda: f"by TLS at {address} from {', '.join(networks) or 'this machine'}", admit),
    ]


def cluster(system: System) -> str:
    """Return the directory of the settings of the newest PostgreSQL.

    Raises:
        ProvisioningError: There is none.
    """
    found = sorted(system.path(CLUSTERS).glob("*/main"), key=lambda path: float(path.parent.name))
    if not found:
        raise ProvisioningError(f"there is no PostgreSQL in {CLUSTERS}: pg_createcluster makes one")
    return f"{CLUSTERS}/{found[-1].parent.name}/main"


def _rules(networks: list[str]) -> list[str]:
    return [f"hostssl {NAME} {NAME} {network} scram-sha-256" for network in networks]


def _psql(*statements: str) -> None:
    """Run statements as the administrator; they may contain a password, so they are not in the log."""
    command = (program("runuser") or "runuser", "-u", "postgres", "--", "psql", "-v", "ON_ERROR_STOP=1", "-q")
    run(*command, secret="".join(f"{each};\n" for each in statements))
