"""PostgreSQL for Masters: the plan, and what the steps write."""

from __future__ import annotations

import pytest

from provisioning import postgresql
from provisioning.postgresql import URL, cluster, setup_steps
from provisioning.steps import ProvisioningError, Step
from provisioning.system import System

HBA = "etc/postgresql/15/main/pg_hba.conf"


@pytest.fixture
def commands(debian: System, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A system with PostgreSQL; commands that run are noted, with what they read."""
    ran: list[str] = []
    (debian.path("/etc/postgresql/15/main/conf.d")).mkdir(parents=True)
    debian.path(f"/{HBA}").write_text("local all all peer\n")

    def run(*words: object, secret: str = "", **_: object) -> str:
        ran.append(" ".join(map(str, words)) + secret)
        return ""

    def write(self: System, name: str, text: str, mode: int, group: str = "root") -> None:
        self.path(name).write_text(text)  # without owner

    monkeypatch.setattr(postgresql, "run", run)
    monkeypatch.setattr(System, "write", write)
    return ran


def steps(system: System) -> dict[str, Step]:
    return {step.name: step for step in setup_steps(system, "10.0.0.5", ["10.0.0.0/24"])}


def test_fresh_machine_gets_the_package(debian: System) -> None:
    assert steps(debian)["system packages"].todo() == "postgresql"
    with pytest.raises(ProvisioningError, match="there is no PostgreSQL"):
        cluster(debian)


def test_database_is_made_once(debian: System, commands: list[str]) -> None:
    steps(debian)["database"].action()
    url = debian.text(URL).strip()
    assert url.startswith("postgresql+psycopg://rce:")
    assert url.endswith("@10.0.0.5/rce")
    assert "CREATE ROLE rce LOGIN PASSWORD" in commands[0]
    assert "CREATE DATABASE rce OWNER rce" in commands[0]
    assert steps(debian)["database"].todo() == ""


def test_masters_are_admitted_by_tls_and_password(debian: System, commands: list[str]) -> None:
    for _ in range(2):
        steps(debian)["connections"].action()
    rules = debian.path(f"/{HBA}").read_text().splitlines()
    assert rules == ["local all all peer", "hostssl rce rce 10.0.0.0/24 scram-sha-256"]
    settings = debian.path("/etc/postgresql/15/main/conf.d/rce.conf").read_text()
    assert settings == "listen_addresses = 'localhost,10.0.0.5'\n"
    assert "systemctl restart postgresql" in commands[0] or commands[0].endswith("restart postgresql")


def test_newest_cluster_is_used(debian: System) -> None:
    for version in ("9.6", "15"):
        debian.path(f"/etc/postgresql/{version}/main").mkdir(parents=True)
    assert cluster(debian) == "/etc/postgresql/15/main"


def test_malformed_network_is_refused() -> None:
    with pytest.raises(ProvisioningError, match="give an address or a network"):
        postgresql._network("10.0.0.1/24")
