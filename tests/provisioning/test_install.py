"""`provision install`: its plan on fake systems, the settings and units that it writes, the choices that it refuses."""

from __future__ import annotations

import argparse
import json
import shutil
import sqlite3
import subprocess
import tomllib
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from containers.settings import Settings as ContainerSettings
from containers.settings import check_isolation
from endpoints.robot.__main__ import Settings as RobotSettings
from master.__main__ import Settings as MasterSettings
from provisioning import configuration, install, joincode, notes, release, services, system, units
from provisioning.configuration import Wanted
from provisioning.steps import Failed, Step
from provisioning.system import System
from rce import settings
from rce.joining import Invitation, JoinCode
from rce.mapservice.__main__ import Settings as MapSettings

SYSTEMS = [("debian", "12", "3.11"), ("debian", "13", "3.13"), ("ubuntu", "24.04", "3.12")]
KINDS: dict[str, Any] = {
    "master": MasterSettings,
    "robot": RobotSettings,
    "container": ContainerSettings,
    "map-service": MapSettings,
}


def make_system(root: Path, name: str, version: str, python: str) -> System:
    """As much of a fresh system as the plan looks at."""
    for place in ("etc/ssl/certs", "usr/bin", "etc/rce"):
        (root / place).mkdir(parents=True)
    (root / "etc/os-release").write_text(f'NAME="x"\nID={name}\nVERSION_ID="{version}"\n')
    (root / "etc/passwd").write_text("root:x:0:0:root:/root:/bin/bash\n")
    (root / "etc/ssl/certs/ca-certificates.crt").touch()
    (root / f"usr/bin/python{python}").touch()
    return System(root)


@pytest.fixture(autouse=True)
def no_docker(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Other tests may have a daemon running, which a fresh system has not."""
    monkeypatch.setenv("DOCKER_HOST", f"unix://{tmp_path}/none.sock")


@pytest.fixture(params=SYSTEMS, ids=lambda each: "-".join(each[:2]))
def fresh(request: pytest.FixtureRequest, tmp_path: Path) -> System:
    return make_system(tmp_path, *request.param)


@pytest.fixture
def debian(tmp_path: Path) -> System:
    return make_system(tmp_path, "debian", "12", "3.11")


def options(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    install.add_commands(parser.add_subparsers())
    return parser.parse_args(["install", *words])


def planned(system: System, *words: str) -> dict[str, str]:
    asked = options(*words)
    steps = install.install_steps(system, install.wanted_from(asked, system), asked)
    return {step.name: step.todo() for step in steps}


def join_code(*roles: str) -> str:
    invitation = Invitation("beta", list(roles), 1, "s")  # type: ignore[arg-type]
    return JoinCode("https://10.0.0.1:8081/", "ab", invitation).text()


def write_settings(system: System, *words: str) -> dict[str, configuration.Settings]:
    """The settings as `install` writes them, on a system without its user."""
    wanted = install.wanted_from(options(*words), system)
    values = configuration.settings(wanted, system)
    for role, value in values.items():
        system.path(f"/etc/rce/{role}.toml").write_text(configuration.text(role, value))
    return values


def test_the_plan_on_a_fresh_system(fresh: System) -> None:
    plan = planned(fresh, "--address", "10.0.0.1")
    assert list(plan) == [
        *("system packages", "user", "directories", "release", "current release", "certificates"),
        *("settings", "units", "administrator", "kernel", "docker", "images", "services"),
    ]
    minor = {"12": "3.11", "13": "3.13", "24.04": "3.12"}[fresh.release()[1]]
    assert plan["system packages"] == f"python{minor}-venv docker.io iptables debootstrap"
    assert "rce[docker,mapping,server]" in plan["release"]
    assert "10.0.0.1" in plan["certificates"]
    assert all(plan.values())


def test_the_plan_without_docker(fresh: System) -> None:
    plan = planned(fresh, "--engine", "process")
    assert "docker" not in plan
    assert {"images", "docker"} & set(plan) == set()
    assert plan["type support"].startswith("build in /opt/rce/typesupport")
    assert "g++" in plan["system packages"].split()


def test_a_machine_that_joins_has_no_secrets_of_the_master(fresh: System) -> None:
    plan = planned(fresh, "--join", join_code("robot", "container"))
    assert "https://10.0.0.1:8081/ for beta" in plan["certificates"]
    assert "administrator" not in plan
    assert plan["settings"] == "/etc/rce/robot.toml /etc/rce/container.toml"


def test_an_unknown_system_is_refused(tmp_path: Path) -> None:
    system = make_system(tmp_path, "fedora", "41", "3.13")
    with pytest.raises(Failed, match=r"this is fedora 41; provision knows debian 12, debian 13, ubuntu 24\.04"):
        planned(system)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--role", "pilot"], "there is no role pilot"),
        (["--role", "robot"], "need a Master"),
        (["--certificate", "c.pem"], "go together"),
        (["--join", "nonsense"], "no join code"),
        (["--join", join_code("container"), "--role", "robot"], "is for container"),
        (["--join", join_code("container"), "--engine", "process"], "--allow-unisolated"),
        (["--http-port", "8080"], "port 8080 would be for"),
    ],
)
def test_what_cannot_be(debian: System, words: list[str], message: str) -> None:
    with pytest.raises(Failed, match=message):
        planned(debian, *words)


def test_a_master_does_not_join_another(debian: System) -> None:
    write_settings(debian, "--role", "master")
    with pytest.raises(Failed, match="has a Master of its own"):
        planned(debian, "--join", join_code("container"))


@pytest.mark.parametrize("engine", ["docker", "process", "swarm"])
def test_the_programs_understand_their_settings(debian: System, engine: str) -> None:
    values = write_settings(debian, "--engine", engine, "--name", "alpha", "--address", "10.0.0.1")
    for role, kind in KINDS.items():
        loaded = settings.load(kind, role, ["--config", str(debian.path(f"/etc/rce/{role}.toml"))], {})
        for name, value in values[role].items():
            assert str(getattr(loaded, name)) == str(value)
        if isinstance(loaded, ContainerSettings):
            check_isolation(loaded)


def test_the_master_knows_the_tokens_of_its_machine(debian: System) -> None:
    values = write_settings(debian, "--name", "alpha")
    robot, container = values["robot"], values["container"]
    maps = values["map-service"]
    expected = [f"robot:alpha-robot:{robot['token']}", f"container:alpha:{container['token']}"]
    expected.append(f"service:map-service:{maps['token']}")
    assert sorted(values["master"]["tokens"]) == sorted(expected)  # type: ignore[arg-type]
    assert len(str(robot["token"])) == 64


def test_once_more_changes_nothing(debian: System) -> None:
    first = write_settings(debian, "--name", "alpha", "--engine", "process", "--size", "3")
    assert planned(debian)["settings"] == ""
    assert write_settings(debian) == first


def test_what_the_operator_wrote_stays(debian: System) -> None:
    write_settings(debian, "--name", "alpha")
    file = debian.path("/etc/rce/robot.toml")
    file.write_text(file.read_text().replace("ws_port = 9010", "ws_port = 9999") + "grace = 60\n")
    values = write_settings(debian)
    assert values["robot"]["ws_port"] == 9999
    assert tomllib.loads(file.read_text())["grace"] == 60


def test_an_option_changes_what_it_says_and_no_more(debian: System) -> None:
    before = write_settings(debian, "--name", "alpha", "--address", "10.0.0.1")
    after = write_settings(debian, "--ws-port", "9999")
    assert after["robot"] == before["robot"] | {"ws_port": 9999, "public_url": "wss://10.0.0.1:9999/"}
    assert after["master"] == before["master"]


def test_a_role_is_added_to_what_is_there(debian: System) -> None:
    write_settings(debian, "--role", "master", "--name", "alpha")
    values = write_settings(debian, "--role", "container", "--engine", "process")
    assert debian.roles() == ("master", "container", "map-service")
    assert len(values["master"]["tokens"]) == 2  # type: ignore[arg-type]


def test_what_the_master_gave_is_used(debian: System) -> None:
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


def test_a_settings_file_that_is_none(debian: System) -> None:
    debian.path("/etc/rce/master.toml").write_text("= nonsense")
    with pytest.raises(Failed, match=r"master\.toml: .*mend it"):
        planned(debian)


# --- units ------------------------------------------------------------------------------------------------------------

ANALYZE = shutil.which("systemd-analyze")
needs_analyze = pytest.mark.skipif(ANALYZE is None, reason="needs systemd-analyze: apt-get install systemd")
CASES = [("master", ""), ("robot", ""), ("map-service", ""), ("container", "process"), ("container", "docker")]


@pytest.fixture
def unit_file(tmp_path: Path) -> Callable[[str, str], Path]:
    def write(role: str, engine: str) -> Path:
        """A unit whose program is there."""
        text = units.text(role, engine)
        assert f"ExecStart={system.CURRENT}/bin/rce {role} --config /etc/rce/{role}.toml\n" in text
        file = tmp_path / system.unit(role)
        file.write_text(text.replace(f"{system.CURRENT}/bin/rce", "/bin/true"))
        return file

    return write


@needs_analyze
@pytest.mark.parametrize(("role", "engine"), CASES)
def test_systemd_takes_the_units(unit_file: Callable[[str, str], Path], role: str, engine: str) -> None:
    command = [str(ANALYZE), "verify", "--man=no", str(unit_file(role, engine))]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert (done.returncode, done.stdout) == (0, "")


@needs_analyze
@pytest.mark.parametrize(("role", "engine"), CASES)
def test_the_units_have_few_rights(unit_file: Callable[[str, str], Path], role: str, engine: str) -> None:
    """Ten times systemd's exposure level, of which 100 is the worst."""
    most = 20 if role == "container" else 15
    command = [str(ANALYZE), "security", "--offline=true", f"--threshold={most}", str(unit_file(role, engine))]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert done.returncode == 0, done.stdout


def test_only_the_task_set_may_speak_to_docker() -> None:
    assert "SupplementaryGroups=docker" in units.text("container", "docker")
    for role, engine in CASES[:-1]:
        assert "docker" not in units.text(role, engine)


def test_only_a_task_set_with_docker_may_use_the_packet_filter() -> None:
    assert "AmbientCapabilities=CAP_NET_ADMIN\n" in units.text("container", "docker")
    for role, engine in [*CASES[:-1], ("container", "swarm")]:
        assert "CAP_" not in units.text(role, engine)


def test_the_others_do_not_see_the_masters_secrets() -> None:
    for role in ("robot", "container", "map-service"):
        for path in ("/etc/rce/authority", "/etc/rce/master.toml", "/var/lib/rce/master"):
            assert f"InaccessiblePaths=-{path}\n" in units.text(role, "docker")


# --- what is told -----------------------------------------------------------------------------------------------------


def test_every_port_is_told(debian: System) -> None:
    values = write_settings(debian, "--ws-port", "9999", "--http-port", "443")
    wanted = install.wanted_from(options("--ws-port", "9999", "--http-port", "443"), debian)
    told = {port for port, _, _ in notes.ports(wanted)}
    maps = values["map-service"]
    assert (maps["entry"], maps["public_url"]) == (
        "https://127.0.0.1:443/",
        f"https://{wanted.address}:{maps['port']}/",
    )
    ports = {values["robot"]["data_port"], values["container"]["data_port"], maps["port"]}
    assert told == {443, 9999, 8080, 8081, *ports}
    assert "9999   from robots" in notes.firewall(wanted)


def test_without_systemd_it_says_how_to_start(debian: System) -> None:
    text = notes.after(debian, Wanted(("master", "container"), "alpha", "10.0.0.1", {"engine": "docker"}))
    assert "runuser -u rce -g rce -- /opt/rce/current/bin/rce master --config /etc/rce/master.toml" in text
    words = "setpriv --reuid rce --regid rce --groups docker --inh-caps -all,+net_admin --ambient-caps -all,+net_admin"
    assert f"{words} --no-new-privs /opt/rce/current/bin/rce container" in text


def test_the_kernel_is_told_once(debian: System) -> None:
    assert planned(debian)["kernel"] == "/etc/sysctl.d/60-rce.conf: net.core.rmem_max = 4194304"
    debian.path("/etc/sysctl.d").mkdir()
    debian.path(services.SYSCTL).touch()
    assert planned(debian)["kernel"] == ""


# --- releases ---------------------------------------------------------------------------------------------------------


def test_a_release_has_the_name_of_its_content(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in release.FILES:
        shutil.copy(release.ROOT / name, tmp_path)
    (tmp_path / "rce").mkdir()
    (tmp_path / "rce" / "a.py").write_text("a = 1")
    monkeypatch.setattr(release, "ROOT", tmp_path)
    first = release.name_of(["server"])
    assert first.startswith("0.1.0-")
    assert release.name_of(["server"]) == first
    assert release.name_of(["server", "docker"]) != first
    (tmp_path / "rce" / "a.py").write_text("a = 2")
    assert release.name_of(["server"]) != first


def test_the_link_changes_and_old_releases_go(tmp_path: Path) -> None:
    releases = tmp_path / "opt/rce/releases"
    link = tmp_path / "opt/rce/current"
    for number in range(4):
        (releases / f"r{number}").mkdir(parents=True)
        release._switch(link, f"releases/r{number}")
    assert release.version_of(System(tmp_path)) == "r3"
    assert len(list(releases.iterdir())) == release.KEPT
    assert (releases / "r2").exists()


# --- the rest ---------------------------------------------------------------------------------------------------------


def test_the_first_user_is_made_once(debian: System) -> None:
    def todo() -> str:
        wanted = Wanted(("master",), "alpha", "10.0.0.1")
        step: Step = services.file_steps(debian, wanted)[-1]
        return step.todo()

    assert todo()
    database = debian.path("/var/lib/rce/master/master.db")
    database.parent.mkdir(parents=True)
    with closing(sqlite3.connect(database)) as connection:
        assert todo()
        connection.execute("CREATE TABLE users (name TEXT)")
        connection.execute("INSERT INTO users VALUES ('admin')")
        connection.commit()
    assert todo() == ""


def test_join_codes_may_be_broken_by_lines() -> None:
    text = join_code("container")
    assert joincode.parse(f"{text[:20]}\n {text[20:]}").name == "beta"
