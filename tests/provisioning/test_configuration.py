"""Settings files: accepted by the programs, kept unless an option overrides them."""

from __future__ import annotations

import json
import os
import tomllib
from typing import Any

import pytest

from containers.settings import Settings as ContainerSettings
from containers.settings import check_isolation
from endpoints.robot.__main__ import Settings as RobotSettings
from master.__main__ import Settings as MasterSettings
from provisioning import (
    configuration,
)
from provisioning.steps import ProvisioningError
from provisioning.system import System
from rce.knowledge.__main__ import Settings as KnowledgeSettings
from rce.mapservice.__main__ import Settings as MapSettings
from rce.process import settings
from tests.support.provisioning.systems import join_code, planned, write_settings

KINDS: dict[str, Any] = {
    "master": MasterSettings,
    "robot": RobotSettings,
    "container": ContainerSettings,
    "map-service": MapSettings,
    "knowledge-service": KnowledgeSettings,
}


@pytest.mark.parametrize("engine", ["docker", "process", "swarm"])
def test_programs_accept_their_settings(debian: System, engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    values = write_settings(debian, "--engine", engine, "--name", "alpha", "--address", "10.0.0.1")
    for role, kind in KINDS.items():
        loaded = settings.load(kind, role, ["--config", str(debian.path(f"/etc/rce/{role}.toml"))], {})
        for name, value in values[role].items():
            assert str(getattr(loaded, name)) == str(value)
        if isinstance(loaded, ContainerSettings):
            monkeypatch.setattr(os, "geteuid", lambda: 999)  # the units have a user of their own
            check_isolation(loaded)


def test_master_has_tokens_of_services_on_its_machine(debian: System) -> None:
    values = write_settings(debian, "--name", "alpha")
    robot, container = values["robot"], values["container"]
    expected = [f"robot:alpha-robot:{robot['token']}", f"container:alpha:{container['token']}"]
    expected += [f"service:{name}:{values[name]['token']}" for name in ("map-service", "knowledge-service")]
    assert sorted(values["master"]["tokens"]) == sorted(expected)  # type: ignore[arg-type]
    assert len(str(robot["token"])) == 64


def test_second_installation_changes_nothing(debian: System) -> None:
    first = write_settings(debian, "--name", "alpha", "--engine", "process", "--size", "3")
    assert planned(debian)["settings"] == ""
    assert write_settings(debian) == first


def test_changes_of_the_operator_are_kept(debian: System) -> None:
    write_settings(debian, "--name", "alpha")
    file = debian.path("/etc/rce/robot.toml")
    file.write_text(file.read_text().replace("ws_port = 9010", "ws_port = 9999") + "grace = 60\n")
    values = write_settings(debian)
    assert values["robot"]["ws_port"] == 9999
    assert tomllib.loads(file.read_text())["grace"] == 60


def test_option_overrides_its_settings_only(debian: System) -> None:
    before = write_settings(debian, "--name", "alpha", "--address", "10.0.0.1")
    after = write_settings(debian, "--ws-port", "9999")
    assert after["robot"] == before["robot"] | {"ws_port": 9999, "public_url": "wss://10.0.0.1:9999/"}
    assert after["master"] == before["master"]


def test_role_is_added_to_installed_ones(debian: System) -> None:
    write_settings(debian, "--role", "master", "--name", "alpha")
    values = write_settings(debian, "--role", "container", "--engine", "process")
    assert debian.roles() == ("master", "container", "map-service", "knowledge-service")
    assert len(values["master"]["tokens"]) == 3  # type: ignore[arg-type]


def test_membership_overrides_settings(debian: System) -> None:
    membership = {
        "master": "10.0.0.1:8080",
        "address": "10.0.0.2",
        "tokens": {"container": "abc"},
        "names": {"container": "beta"},
        "joined_with": "x",
    }
    debian.path(configuration.MEMBERSHIP).write_text(json.dumps(membership))
    values = write_settings(debian, "--join", join_code("container"))["container"]
    assert (values["master"], values["token"], values["name"]) == ("tcp:10.0.0.1:8080", "abc", "beta")
    assert values["data_address"] == "10.0.0.2"
    membership["tokens"] = {"container": "new"}  # it joins again
    debian.path(configuration.MEMBERSHIP).write_text(json.dumps(membership))
    assert write_settings(debian)["container"]["token"] == "new"


def test_malformed_settings_file_is_refused(debian: System) -> None:
    debian.path("/etc/rce/master.toml").write_text("= nonsense")
    with pytest.raises(ProvisioningError, match=r"master\.toml: .*correct it"):
        planned(debian)


HA = ("--database", "postgresql+psycopg://rce:secret@db/rce", "--masters", "10.0.0.1,10.0.0.2")
BOTH = "tcp:10.0.0.1:8080,tcp:10.0.0.2:8080"


def test_first_of_two_masters_has_the_services_and_all_know_both(debian: System) -> None:
    values = write_settings(debian, "--name", "alpha", "--address", "10.0.0.1", *HA)
    assert set(values) == {"master", "robot", "container", "map-service", "knowledge-service"}
    assert values["master"]["database"] == HA[1]
    assert values["master"]["masters"] == ["10.0.0.1", "10.0.0.2"]
    assert {values[role]["master"] for role in values.keys() - {"master"}} == {BOTH}
    assert values["map-service"]["entry"] == "https://10.0.0.1:9000/,https://10.0.0.2:9000/"
    assert write_settings(debian) == values
    loaded = settings.load(MasterSettings, "master", ["--config", str(debian.path("/etc/rce/master.toml"))], {})
    assert loaded.masters == ["10.0.0.1", "10.0.0.2"]


def test_standby_is_a_master_only(debian: System) -> None:
    values = write_settings(debian, "--role", "master", "--name", "beta", "--address", "10.0.0.2", *HA)
    assert set(values) == {"master"}
    assert set(write_settings(debian)) == {"master"}


def test_machine_that_joins_two_masters_knows_both(debian: System) -> None:
    membership = {"master": "a:8080,b:8080", "address": "c", "tokens": {"robot": "t"}, "names": {"robot": "n"}}
    assert configuration._membership(membership, "robot")["master"] == "tcp:a:8080,tcp:b:8080"
