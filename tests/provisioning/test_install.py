"""`provision install`: its plan on fake systems, and options that it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from provisioning.steps import ProvisioningError
from provisioning.system import System
from tests.support.provisioning.systems import join_code, make_system, planned, write_settings


def test_plan_on_fresh_system(fresh: System) -> None:
    plan = planned(fresh, "--address", "10.0.0.1")
    assert list(plan) == [
        *("system packages", "user", "directories", "release", "current release", "certificates"),
        *("settings", "units", "administrator", "kernel", "docker", "images", "services"),
    ]
    minor = {"12": "3.11", "13": "3.13", "24.04": "3.12"}[fresh.release()[1]]
    assert plan["system packages"] == f"python{minor}-venv docker.io iptables debootstrap"
    assert "rce[docker,knowledge,mapping,server]" in plan["release"]
    assert "10.0.0.1" in plan["certificates"]
    assert all(plan.values())


def test_plan_without_docker(fresh: System) -> None:
    plan = planned(fresh, "--engine", "process")
    assert "docker" not in plan
    assert {"images", "docker"} & set(plan) == set()
    assert plan["type support"].startswith("build what is missing in /opt/rce/typesupport")
    assert "g++" in plan["system packages"].split()


def test_joining_machine_has_no_administrator(fresh: System) -> None:
    plan = planned(fresh, "--join", join_code("robot", "container"))
    assert "for beta from https://10.0.0.1:8081/" in plan["certificates"]
    assert "administrator" not in plan
    assert plan["settings"] == "/etc/rce/robot.toml /etc/rce/container.toml"


def test_unsupported_system_is_refused(tmp_path: Path) -> None:
    system = make_system(tmp_path, "fedora", "41", "3.13")
    with pytest.raises(
        ProvisioningError, match=r"this is fedora 41; provision supports debian 12, debian 13, ubuntu 24\.04"
    ):
        planned(system)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--role", "pilot"], "there is no role pilot"),
        (["--role", "robot"], "need a Master"),
        (["--certificate", "c.pem"], "go together"),
        (["--join", "nonsense"], "not a complete join code"),
        (["--join", join_code("container"), "--role", "robot"], "is for container"),
        (["--join", join_code("container"), "--engine", "process"], "--allow-unisolated"),
        (["--http-port", "8080"], "port 8080 is used for"),
    ],
)
def test_contradictory_options_are_refused(debian: System, words: list[str], message: str) -> None:
    with pytest.raises(ProvisioningError, match=message):
        planned(debian, *words)


def test_master_cannot_join_another(debian: System) -> None:
    write_settings(debian, "--role", "master")
    with pytest.raises(ProvisioningError, match="has a Master of its own"):
        planned(debian, "--join", join_code("container"))


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--masters", "a,b", "--address", "a"], "several Masters share a PostgreSQL: add --database"),
        (["--masters", "a,b", "--address", "c", "--database", "postgresql+psycopg://x"], "has not the address of this"),
    ],
)
def test_masters_that_cannot_work_together_are_refused(debian: System, words: list[str], reason: str) -> None:
    with pytest.raises(ProvisioningError, match=reason):
        planned(debian, *words)
