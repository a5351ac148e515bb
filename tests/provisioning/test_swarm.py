"""`provision swarm`."""

from __future__ import annotations

import argparse
import json
from typing import Any

import pytest

from provisioning import (
    swarm,
)
from provisioning.steps import ProvisioningError
from provisioning.system import System


def parsed(module: Any, *words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    module.add_commands(parser.add_subparsers())
    return parser.parse_args(words)


@pytest.fixture
def without_docker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(swarm, "docker_answers", lambda: False)


@pytest.mark.usefixtures("without_docker")
def test_plans(installed: System) -> None:
    def plan(*words: str) -> dict[str, str]:
        return {step.name: step.todo() for step in swarm.swarm_steps(installed, parsed(swarm, "swarm", *words))}

    assert plan("init", "--address", "10.0.0.1")["swarm"] == "docker swarm init --advertise-addr 10.0.0.1"
    joining = plan("join", "10.0.0.1:2377", "--token", "SWMTKN-1", "--address", "10.0.0.2")["swarm"]
    assert joining == "docker swarm join --advertise-addr 10.0.0.2 --token '…' 10.0.0.1:2377"
    with pytest.raises(ProvisioningError, match="needs the manager's HOST:PORT"):
        plan("join")


@pytest.mark.usefixtures("without_docker")
def test_settings_of_docker_are_kept(installed: System) -> None:
    file = installed.path(swarm.SETTINGS)
    file.parent.mkdir()
    file.write_text('{"bip": "172.20.0.1/16", "log-driver": "journald"}')
    step = swarm._settings_step(installed, "10.0.0.1")
    assert step.todo()
    step.action()
    written = json.loads(file.read_text())
    assert written == {"bip": "172.20.0.1/16", **swarm.DAEMON_SETTINGS, "insecure-registries": ["10.0.0.1/32"]}
    assert swarm._settings_step(installed, "10.0.0.1").todo() == ""


@pytest.mark.parametrize(
    ("text", "message"), [("nonsense", "correct it first"), ('{"live-restore": true}', "refuses a swarm")]
)
def test_unsuitable_settings_of_docker_are_refused(installed: System, text: str, message: str) -> None:
    installed.path(swarm.SETTINGS).parent.mkdir()
    installed.path(swarm.SETTINGS).write_text(text)
    with pytest.raises(ProvisioningError, match=message):
        swarm._settings_step(installed, "10.0.0.1")


def test_features_become_labels(capsys: pytest.CaptureFixture[str]) -> None:
    swarm.swarm(parsed(swarm, "swarm", "label", "beta", "--feature", "gpu", "--dry-run"), [])
    assert "docker node update --label-add rce.feature.gpu=true beta" in capsys.readouterr().out
