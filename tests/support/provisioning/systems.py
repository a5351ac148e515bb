"""Fake systems that `provision install` makes plans for."""

from __future__ import annotations

import argparse
from pathlib import Path

from provisioning import (
    configuration,
    install,
)
from provisioning.system import System
from rce.api.joining import Invitation, JoinCode


def make_system(root: Path, name: str, version: str, python: str) -> System:
    """Make the files of a fresh system that the plan reads."""
    for place in ("etc/ssl/certs", "usr/bin", "etc/rce"):
        (root / place).mkdir(parents=True)
    (root / "etc/os-release").write_text(f'NAME="x"\nID={name}\nVERSION_ID="{version}"\n')
    (root / "etc/passwd").write_text("root:x:0:0:root:/root:/bin/bash\n")
    (root / "etc/ssl/certs/ca-certificates.crt").touch()
    (root / f"usr/bin/python{python}").touch()
    return System(root)


def options(*words: str) -> argparse.Namespace:
    """Parse options of `install`."""
    parser = argparse.ArgumentParser()
    install.add_commands(parser.add_subparsers())
    return parser.parse_args(["install", *words])


def planned(system: System, *words: str) -> dict[str, str]:
    """Return what the steps of `install` with these options would do, by name."""
    given = options(*words)
    steps = install.install_steps(system, install.planned_installation(given, system), given)
    return {step.name: step.todo() for step in steps}


def join_code(*roles: str) -> str:
    """Return a join code for these roles."""
    invitation = Invitation("beta", list(roles), 1, "s")  # type: ignore[arg-type]
    return JoinCode("https://10.0.0.1:8081/", "ab", invitation).text()


def write_settings(system: System, *words: str) -> dict[str, configuration.Settings]:
    """Write settings as `install` does, but without owner and mode, and return them."""
    installation = install.planned_installation(options(*words), system)
    values = configuration.settings(installation, system)
    for role, value in values.items():
        system.path(f"/etc/rce/{role}.toml").write_text(configuration.text(role, value))
    return values
