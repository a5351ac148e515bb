"""`provision machine`."""

from __future__ import annotations

import argparse
from typing import Any

import pytest

from provisioning import (
    machine,
)
from provisioning.steps import ProvisioningError
from provisioning.system import System


def parsed(module: Any, *words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    module.add_commands(parser.add_subparsers())
    return parser.parse_args(words)


def test_add_runs_the_command_of_the_master(capsys: pytest.CaptureFixture[str]) -> None:
    options = parsed(machine, "machine", "add", "beta", "--role", "robot,container", "--hours", "2", "--dry-run")
    assert machine.machine(options, []) == 0
    expected = "machine --config=/etc/rce/master.toml add beta --role=robot --role=container --hours=2"
    assert capsys.readouterr().out.strip().endswith(f"/opt/rce/current/bin/rce {expected}")


def test_add_without_name_or_master_is_refused() -> None:
    with pytest.raises(ProvisioningError, match="needs the NAME"):
        machine.machine(parsed(machine, "machine", "add"), [])
    if not System().roles():
        with pytest.raises(ProvisioningError, match="no Master on this machine"):
            machine.machine(parsed(machine, "machine", "add", "beta"), [])
