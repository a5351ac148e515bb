"""The whole platform on one machine: command lines of its processes, and their order."""

from __future__ import annotations

import asyncio
import io
import os
import socket
import sys
from pathlib import Path
from unittest.mock import Mock

import msgspec
import pytest

from rce.errors import InvalidRequest, StartFailed, Unavailable
from rce.process import programs, up
from rce.process.ready import Ready
from rce.process.settings import load
from rce.process.supervisor import ManagedProcess

# A program that is ready at once, and records in a file when it starts and when it is terminated.
PROGRAM = """
import json, signal, sys
name, file = sys.argv[1:3]
def note(what):
    with open(file, "a") as log:
        log.write(f"{what} {name}\\n")
def end(*_):
    note("stop")
    sys.exit()
signal.signal(signal.SIGTERM, end)
note("start")
print(json.dumps({"program": name, "url": "http://0.0.0.0:1/", "control": "tcp:127.0.0.1:2"}), flush=True)
signal.pause()
"""


def arguments(process: ManagedProcess) -> dict[str, str]:
    """Return the options of a process that would be started now; switches have an empty value."""
    return {name: value for name, _, value in (each.partition("=") for each in process._arguments())}


def lines(record: Path) -> list[str]:
    return record.read_text().splitlines()


@pytest.fixture
def settings(tmp_path: Path) -> up.Settings:
    return up.Settings(data_dir=tmp_path / "data", typesupport="", allow_root=True)


@pytest.fixture
def on_free_ports(settings: up.Settings) -> up.Settings:
    return msgspec.structs.replace(settings, http_port=0)


@pytest.fixture
def record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """File in which stand-ins of all programs record their starts and ends."""
    file = tmp_path / "record"
    monkeypatch.setattr(programs, "command", lambda name: [sys.executable, "-c", PROGRAM, name, str(file)])
    monkeypatch.setattr(programs, "installed", lambda *names: True)
    return file


def test_processes_have_directories_of_their_own_and_one_secret_each(settings: up.Settings) -> None:
    processes = up.make_processes(settings, io.StringIO())
    master, *others = processes
    master.ready = Ready("master", "http://127.0.0.1:9000/", "tcp:127.0.0.1:8080")
    directories = {process.name: arguments(process)["--data-dir"] for process in processes}
    data = settings.data_dir
    assert directories == {
        "master": f"{data}/master",
        "robot": f"{data}/robot",
        "container": f"{data}/container",
        "map-service": f"{data}/maps",
        "knowledge-service": f"{data}/knowledge",
    }
    tokens = [process._environment["RCE_TOKEN"] for process in others]
    allowed = dict(each.rsplit(":", 1)[::-1] for each in master._environment["RCE_TOKENS"].split(","))
    names = ["robot:robot-1", "container:machine-1", "service:map-service", "service:knowledge-service"]
    assert allowed == dict(zip(tokens, names, strict=True))
    assert len(set(tokens)) == 4


def test_others_dial_the_port_that_the_master_got(settings: up.Settings) -> None:
    settings.http_port = settings.ws_port = settings.maps_port = 0
    master, robot, container, maps, _ = up.make_processes(settings, io.StringIO())
    assert arguments(master)["--http"] == "tcp:0:interface=127.0.0.1"
    assert arguments(master)["--control"] == "tcp:0:interface=127.0.0.1"
    master.ready = Ready("master", "http://0.0.0.0:9123/", "tcp:127.0.0.1:8123")
    for process in (robot, container, maps):
        assert arguments(process)["--master"] == "tcp:127.0.0.1:8123"
    assert arguments(maps)["--entry"] == "http://127.0.0.1:9123/", "0.0.0.0 cannot be dialled"
    assert arguments(robot)["--ws-port"] == "0"
    assert arguments(maps)["--port"] == "0"


def test_restarted_processes_keep_their_ports(settings: up.Settings) -> None:
    settings.http_port = settings.ws_port = settings.maps_port = 0
    master, robot, _, maps, _ = up.make_processes(settings, io.StringIO())
    master.ready = Ready("master", "http://127.0.0.1:9123/", "tcp:127.0.0.1:8123")
    robot.ready = Ready("robot", "ws://127.0.0.1:9124/")
    maps.ready = Ready("map-service", "http://127.0.0.1:9125/")
    assert arguments(master)["--http"] == "tcp:9123:interface=127.0.0.1"
    assert arguments(master)["--control"] == "tcp:8123:interface=127.0.0.1"
    assert arguments(robot)["--ws-port"] == "9124"
    assert arguments(maps)["--port"] == "9125"


def test_development_listens_on_loopback_only(settings: up.Settings) -> None:
    settings.host, settings.dev = "0.0.0.0", True
    master, robot, _, maps, _ = up.make_processes(settings, io.StringIO())
    master.ready = Ready("master", "http://127.0.0.1:9000/", "tcp:127.0.0.1:8080")
    assert arguments(master)["--http"] == "tcp:9000:interface=127.0.0.1"
    assert "--dev" in arguments(master)
    assert arguments(robot)["--ws-host"] == arguments(maps)["--host"] == "127.0.0.1"


@pytest.mark.parametrize("key", ["/k.pem", ""])
def test_certificate_is_for_all_ports_of_users(settings: up.Settings, key: str) -> None:
    settings.certificate, settings.private_key = "/c.pem", key
    master, robot, container, maps, _ = up.make_processes(settings, io.StringIO())
    master.ready = Ready("master", "https://127.0.0.1:9000/", "tcp:127.0.0.1:8080")
    assert arguments(master)["--http"].startswith("ssl:9000:interface")
    assert f"ssl:9000:interface=127.0.0.1:privateKey={key or '/c.pem'}:certKey=/c.pem" in master._arguments()[1]
    assert arguments(robot)["--certificate"] == arguments(maps)["--certificate"] == "/c.pem"
    assert arguments(maps)["--trust"] == "/c.pem"
    assert "--certificate" not in arguments(container)


def test_type_support_of_provisioning_is_used_if_it_was_built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    assert up.default_typesupport() == ""
    built = tmp_path / "typesupport" / "1"
    built.mkdir(parents=True)
    (tmp_path / "typesupport" / "current").symlink_to(built)
    assert up.default_typesupport() == str(built)


async def test_master_starts_first_and_ends_last(on_free_ports: up.Settings, record: Path) -> None:
    entries: list[Ready] = []

    async def started(entry: Ready) -> None:
        entries.append(entry)
        names = {"master", "robot", "container", "map-service", "knowledge-service"}
        assert {*lines(record)} == {f"start {name}" for name in names}

    with (record.parent / "log").open("w") as log:
        await up.run(on_free_ports, started, log)
    assert [entry.program for entry in entries] == ["master"]
    assert lines(record)[0] == "start master"
    ended = ["map-service", "knowledge-service", "container", "robot", "master"]
    assert lines(record)[5:] == [f"stop {name}" for name in ended]


async def test_platform_is_not_started_if_a_process_fails(
    on_free_ports: up.Settings, record: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    works = programs.command
    monkeypatch.setattr(
        programs, "command", lambda name: [sys.executable, "-c", "pass"] if name == "robot" else works(name)
    )

    async def started(entry: Ready) -> None:
        raise AssertionError("the platform is not complete")

    with (record.parent / "log").open("w") as log, pytest.raises(StartFailed, match="rce robot did not start"):
        await up.run(on_free_ports, started, log)
    assert lines(record)[-1] == "stop master"


async def test_port_in_use_is_reported_before_anything_starts(settings: up.Settings) -> None:
    """The Master would print the password of the first administrator, and the platform would not start."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        taken = msgspec.structs.replace(settings, http_port=0, ws_port=port)
        with pytest.raises(Unavailable, match=f"port {port} of 127.0.0.1 is in use: choose another port"):
            await up.run(taken, Mock(), sys.stderr)
    assert not settings.data_dir.exists()


async def test_starts_under_way_are_cancelled_if_a_process_fails(
    on_free_ports: up.Settings, record: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Or a process that starts late would not be stopped."""
    begun, events = asyncio.Event(), []

    async def start(process: ManagedProcess) -> Ready:
        if process.name == "robot":
            await begun.wait()
            raise StartFailed("rce robot did not start")
        if process.name == "container":
            begun.set()
            try:
                await asyncio.Event().wait()
            finally:
                events.append("start of the container is cancelled")
        return Ready(process.name)

    async def stop(process: ManagedProcess) -> None:
        events.append(f"stop {process.name}")

    async def started(entry: Ready) -> None:
        raise AssertionError("the platform is not complete")

    monkeypatch.setattr(ManagedProcess, "start", start)
    monkeypatch.setattr(ManagedProcess, "stop", stop)
    with pytest.raises(StartFailed, match="robot"):
        await up.run(on_free_ports, started, io.StringIO())
    assert events[0] == "start of the container is cancelled"


async def test_platform_starts_without_services_that_are_not_installed(
    on_free_ports: up.Settings, record: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(programs, "installed", lambda *names: False)

    async def started(entry: Ready) -> None:
        assert not {"start map-service", "start knowledge-service"} & {*lines(record)}

    with (record.parent / "log").open("w+") as log:
        await up.run(on_free_ports, started, log)
        log.seek(0)
        text = log.read()
        assert "starting without the map service" in text
        assert "pip install '.[server,knowledge]'" in text


@pytest.mark.parametrize(
    ("given", "ports"),
    [
        ([], ("9010", "9040")),
        (["--http-port=0"], ("0", "0")),
        (["--http-port=0", "--ws-port=9555"], ("9555", "0")),
        (["--http-port=0", "--maps-port=9010"], ("0", "9010")),
        (["--ws-port=0"], ("0", "9040")),
    ],
)
def test_free_port_for_the_entry_means_free_ports_where_none_is_given(given: list[str], ports: tuple[str, str]) -> None:
    master, robot, _, maps, _ = up.make_processes(load(up.Settings, "rce up", given, {}), io.StringIO())
    master.ready = Ready("master", "http://127.0.0.1:9123/", "tcp:127.0.0.1:8123")
    assert (arguments(robot)["--ws-port"], arguments(maps)["--port"]) == ports


def test_welcome_has_the_address_and_how_to_sign_in(settings: up.Settings) -> None:
    lines = up.welcome(settings, "http://127.0.0.1:9000/", Path("/data/up.log")).splitlines()
    assert any("dashboard" in line and "http://127.0.0.1:9000/" in line for line in lines)
    assert any("rce login http://127.0.0.1:9000/ --user admin" in line for line in lines)
    assert len(lines) <= 10


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.0.2", "robots.example"])
async def test_engine_without_isolation_does_not_serve_other_machines(settings: up.Settings, host: str) -> None:
    settings.host = host

    async def started(entry: Ready) -> None:
        pytest.fail("it has started")

    with pytest.raises(InvalidRequest, match=r"not a loopback address: use --engine docker, or --allow-unisolated"):
        await up.run(settings, started, io.StringIO())


def test_other_machines_are_served_on_request_and_by_engines_with_isolation(settings: up.Settings) -> None:
    settings.host = "0.0.0.0"
    up.check_isolation(msgspec.structs.replace(settings, allow_unisolated=True))
    up.check_isolation(msgspec.structs.replace(settings, engine="docker"))
    with pytest.raises(InvalidRequest, match=r"passwords everybody knows.*0\.0\.0\.0.*leave out --host, or --dev"):
        up.check_isolation(msgspec.structs.replace(settings, engine="docker", dev=True))
    for local in ("127.0.0.1", "::1", "localhost"):
        up.check_isolation(msgspec.structs.replace(settings, host=local))


def test_nodes_run_as_root_only_on_request(settings: up.Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    settings.allow_root = False
    with pytest.raises(InvalidRequest, match=r"as root.*--allow-root"):
        up.check_isolation(settings)
    up.check_isolation(msgspec.structs.replace(settings, engine="docker"))
    up.check_isolation(msgspec.structs.replace(settings, allow_root=True))


def test_isolation_is_one_line() -> None:
    assert up.isolation("process").startswith("the process engine does not isolate: nodes of all users run as ")
    assert up.isolation("docker").startswith("the docker engine isolates")
