"""`provision` after the installation: machines, swarms, upgrades, removal; their plans and what they write."""

from __future__ import annotations

import argparse
import json
import shutil
import sqlite3
import subprocess
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import yaml

from provisioning import cloudinit, machine, swarm, upkeep
from provisioning.joincode import Code
from provisioning.steps import Failed
from provisioning.system import System

CODE = Code("rce1-abc", "https://10.0.0.1:8081/", "beta", ("robot", "container"))
AUTHORITY = "-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n"


def parsed(module: Any, *words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    module.add_commands(parser.add_subparsers())
    return parser.parse_args(words)


@pytest.fixture
def system(tmp_path: Path) -> System:
    """Where all roles are installed."""
    for place in ("etc/rce", "var/lib/rce/master", "opt/rce", "etc/systemd/system", "etc/sysctl.d"):
        (tmp_path / place).mkdir(parents=True)
    (tmp_path / "etc/sysctl.d/60-rce.conf").touch()
    for role in ("master", "robot", "container", "map-service"):
        (tmp_path / f"etc/rce/{role}.toml").touch()
        (tmp_path / f"etc/systemd/system/rce-{role}.service").touch()
    (tmp_path / "etc/passwd").write_text("rce:x:999:999::/:/bin/false\n")
    return System(tmp_path)


# --- machines ---------------------------------------------------------------------------------------------------------


def test_machine_add_asks_the_master(capsys: pytest.CaptureFixture[str]) -> None:
    options = parsed(machine, "machine", "add", "beta", "--role", "robot,container", "--hours", "2", "--dry-run")
    assert machine.machine(options, []) == 0
    expected = "machine --config=/etc/rce/master.toml add beta --role=robot --role=container --hours=2"
    assert capsys.readouterr().out.strip().endswith(f"/opt/rce/current/bin/rce {expected}")


def test_machine_needs_a_name_and_a_master() -> None:
    with pytest.raises(Failed, match="needs the NAME"):
        machine.machine(parsed(machine, "machine", "add"), [])
    if not System().roles():
        with pytest.raises(Failed, match="no Master on this machine"):
            machine.machine(parsed(machine, "machine", "add", "beta"), [])


# --- cloud-init -------------------------------------------------------------------------------------------------------


def test_user_data() -> None:
    text = cloudinit.user_data(CODE, AUTHORITY, "--size 4 --no-images")
    assert text.startswith("#cloud-config\n")
    assert len(text) < 16_384  # what clouds take
    config = yaml.safe_load(text)
    assert config["hostname"] == "beta"
    files = {file["path"]: file for file in config["write_files"]}
    assert files[cloudinit.CA]["content"] == AUTHORITY
    assert files[cloudinit.CODE] == {"path": cloudinit.CODE, "permissions": "0600", "content": "rce1-abc"}
    (command,) = config["runcmd"]
    assert command[:2] == ["sh", "-ec"]
    assert (
        "--cacert /etc/rce/bootstrap-ca.pem --output /usr/local/src/rce.tar.gz https://10.0.0.1:8081/source"
        in command[2]
    )
    assert "install --role robot,container --name beta --size 4 --no-images --join" in command[2]
    assert steps_of(command[2]) == ["mkdir", "curl", "tar", "cat", "provision", "rm", "provision"]


def steps_of(script: str) -> list[str]:
    """The programs that a script runs, in order; each is replaced by one that does nothing."""
    names = ("mkdir", "curl", "tar", "rm", "cat")
    harmless = "".join(f"{name}() {{ echo {name} >&2; }}\n" for name in (*names, "provision"))
    script = script.replace(f"{cloudinit.SOURCE}/provisioning/provision", "provision")
    done = subprocess.run(["sh", "-euc", harmless + script], env={}, check=True, capture_output=True, text=True)
    return done.stderr.split()


@pytest.mark.skipif(shutil.which("cloud-init") is None, reason="needs cloud-init: apt-get install cloud-init")
def test_cloud_init_takes_it(tmp_path: Path) -> None:
    (tmp_path / "user-data").write_text(cloudinit.user_data(CODE, AUTHORITY))
    command = ["cloud-init", "schema", "--config-file", str(tmp_path / "user-data")]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert done.returncode == 0, done.stdout


# --- swarm ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def without_docker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(swarm, "docker_answers", lambda: False)


@pytest.mark.usefixtures("without_docker")
def test_swarm_plans(system: System) -> None:
    def plan(*words: str) -> dict[str, str]:
        return {step.name: step.todo() for step in swarm.swarm_steps(system, parsed(swarm, "swarm", *words))}

    assert plan("init", "--address", "10.0.0.1")["swarm"] == "docker swarm init --advertise-addr 10.0.0.1"
    joining = plan("join", "10.0.0.1:2377", "--token", "SWMTKN-1", "--address", "10.0.0.2")["swarm"]
    assert joining == "docker swarm join --advertise-addr 10.0.0.2 --token '…' 10.0.0.1:2377"
    with pytest.raises(Failed, match="needs the manager's HOST:PORT"):
        plan("join")


@pytest.mark.usefixtures("without_docker")
def test_dockers_settings_keep_what_is_there(system: System) -> None:
    file = system.path(swarm.SETTINGS)
    file.parent.mkdir()
    file.write_text('{"bip": "172.20.0.1/16", "log-driver": "journald"}')
    step = swarm._settings_step(system, "10.0.0.1")
    assert step.todo()
    step.action()
    written = json.loads(file.read_text())
    assert written == {"bip": "172.20.0.1/16", **swarm.WANTED, "insecure-registries": ["10.0.0.1/32"]}
    assert swarm._settings_step(system, "10.0.0.1").todo() == ""


@pytest.mark.parametrize(
    ("text", "message"), [("nonsense", "mend it first"), ('{"live-restore": true}', "refuses a swarm")]
)
def test_dockers_settings_that_do_not_fit(system: System, text: str, message: str) -> None:
    system.path(swarm.SETTINGS).parent.mkdir()
    system.path(swarm.SETTINGS).write_text(text)
    with pytest.raises(Failed, match=message):
        swarm._settings_step(system, "10.0.0.1")


def test_features_are_labels(capsys: pytest.CaptureFixture[str]) -> None:
    swarm.swarm(parsed(swarm, "swarm", "label", "beta", "--feature", "gpu", "--dry-run"), [])
    assert "docker node update --label-add rce.feature.gpu=true beta" in capsys.readouterr().out


# --- upkeep -----------------------------------------------------------------------------------------------------------


def test_the_backup_is_of_the_database(system: System) -> None:
    database = system.path("/var/lib/rce/master/master.db")
    assert upkeep._backup_step(system).todo() == ""
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("CREATE TABLE users (name TEXT)")
        connection.commit()
    system.path("/opt/rce/current").symlink_to("releases/0.1.0-abc")
    step = upkeep._backup_step(system)
    copy = Path(step.action())
    assert copy.name == "master-0.1.0-abc.db"
    assert copy.stat().st_mode & 0o777 == 0o600
    with closing(sqlite3.connect(copy)) as connection:
        assert connection.execute("SELECT name FROM sqlite_master").fetchall() == [("users",)]


def uninstalled(system: System, purge: bool, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    monkeypatch.setattr(upkeep, "docker_answers", lambda: False)
    steps = upkeep.uninstall_steps(system, purge)
    plan = {step.name: step.todo() for step in steps}
    for step in steps:
        if step.name in ("units", "kernel", "code", "settings and data"):
            step.action()
    return plan


def test_uninstall_keeps_settings_and_data(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = uninstalled(system, False, monkeypatch)
    assert plan["services"] == "stop rce-master.service rce-robot.service rce-container.service rce-map-service.service"
    assert system.path("/etc/rce/master.toml").exists()
    assert system.path("/var/lib/rce/master").exists()
    assert not system.path("/opt/rce").exists()
    assert list(system.path("/etc/systemd/system").iterdir()) == []


def test_purge_leaves_nothing(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = uninstalled(system, True, monkeypatch)
    assert plan["user"] == "remove rce"
    assert [path for path in system.root.rglob("*rce*") if path != system.root] == []
    again = upkeep.uninstall_steps(system, True)
    assert {step.name for step in again if step.todo()} <= {"processes", "user"}
