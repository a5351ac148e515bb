# ruff: noqa: E402  (imports after importorskip)
"""Resources that an agent provides for environments on its node: disks, limits, networks and packages."""

from __future__ import annotations

import io
import os
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.endpoint import environment_user
from containers.swarm.engine import SwarmEngine
from rce.control.calls.environments import DownloadTicket, EnvironmentSpec, Group
from rce.errors import InvalidRequest, NotFound, StartFailed
from rce.packages import archive
from rce.protocol.messages import ContainerData, Rates
from rce.protocol.slots import MB
from tests.support.containers.engine_contract import spec, with_options
from tests.support.containers.swarm_world import SwarmWorld

NET = "10.128.0.0/24"
PORT = 7000
REACH = "import socket; socket.create_connection(({address!r}, {port}), 3)"
LISTEN = "import socket; s = socket.create_server(({address!r}, {port})); print(flush=True); s.accept()"


def within(process: int, *words: str) -> str:
    """Run a program of this machine in the network namespace of an environment; return its output."""
    command = ["nsenter", f"--net=/proc/{process}/ns/net", *words]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@contextmanager
def listening(process: int, address: str) -> Iterator[None]:
    program = ["python3", "-c", LISTEN.format(address=address, port=PORT)]
    command = ["nsenter", f"--net=/proc/{process}/ns/net", *program]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as running:
        assert running.stdout is not None
        running.stdout.readline()
        yield
        running.kill()


def read(process: int, file: str) -> str:
    """Read a file as the environment sees it."""
    return Path(f"/proc/{process}/root/{file}").read_text()


def process_of(world: SwarmWorld, name: str) -> int:
    process: int = world.inspect(name)["State"]["Pid"]
    return process


def mounted(process: int, path: str) -> tuple[str, str]:
    """Return type and source of the topmost mount at a path."""
    lines = [line.split() for line in Path(f"/proc/{process}/mountinfo").read_text().splitlines()]
    line = next(line for line in reversed(lines) if line[4] == path)
    kind, source = line[line.index("-") + 1 :][:2]
    return kind, source


def limits_of(process: int) -> dict[str, tuple[int, int]]:
    """Return the limits of bytes per second read and written, by device."""
    lines = [line.split(":", 2) for line in Path(f"/proc/{process}/cgroup").read_text().splitlines()]
    if Path("/sys/fs/cgroup/cgroup.controllers").exists():
        text = Path(f"/sys/fs/cgroup{lines[0][2]}/io.max").read_text()
        held = {line.split()[0]: dict(word.split("=") for word in line.split()[1:]) for line in text.splitlines()}
        return {device: (int(rates["rbps"]), int(rates["wbps"])) for device, rates in held.items()}
    path = next(path for _, controllers, path in lines if "blkio" in controllers.split(","))
    place = Path(f"/sys/fs/cgroup/blkio{path}")
    read, written = (
        dict(line.split() for line in (place / f"blkio.throttle.{way}_bps_device").read_text().splitlines())
        for way in ("read", "write")
    )
    return {device: (int(read[device]), int(written.get(device, 0))) for device in read}


def disks() -> str:
    return "".join(file.read_text() for file in Path("/sys/block").glob("loop*/loop/backing_file"))


async def test_disk_rates_and_bandwidth_are_limited(world: SwarmWorld, engine: SwarmEngine) -> None:
    """All limits are set from outside, before the endpoint reaches the Master."""
    await engine.start(with_options(disk=16 * MB, bandwidth=MB, io=Rates(read=3 * MB, write=2 * MB)))
    process = process_of(world, "ann/map")
    kind, device = mounted(process, "/home/rce")
    assert kind == "ext4"
    home = f"/proc/{process}/root/home/rce"
    seen = os.statvfs(home)
    assert 13 * MB < seen.f_bavail * seen.f_frsize <= 16 * MB
    assert os.stat(home).st_uid == environment_user("ann/map")
    number = os.stat(device).st_rdev
    assert limits_of(process)[f"{os.major(number)}:{os.minor(number)}"] == (3 * MB, 2 * MB)
    assert "tbf" in within(process, "tc", "qdisc", "show", "dev", "eth0")
    assert f"rce-{spec().run}-disk/" in disks()
    await engine.stop("ann/map")
    assert f"rce-{spec().run}-disk/" not in disks()


async def test_unavailable_resources_fail_the_start_and_leave_nothing(world: SwarmWorld, engine: SwarmEngine) -> None:
    with pytest.raises(InvalidRequest, match="less than the smallest"):
        await engine.start(with_options(disk=1000))
    with pytest.raises(StartFailed, match=r"No space left|too large"):
        await engine.start(with_options(disk=2**45))
    with pytest.raises(NotFound, match="no Master to ask"):
        await engine.start(replace(with_options(), packages=["0" * 64]))
    assert world.remains() == set()


async def test_group_members_have_their_addresses_and_names(world: SwarmWorld, engine: SwarmEngine) -> None:
    """The first member also gets the name of one that joined later."""
    members = {"map": "10.128.0.50", "plan": "10.128.0.7"}
    first = Group("ann/g", NET, "10.128.0.50", {"map": "10.128.0.50"})
    second = Group("ann/g", NET, "10.128.0.7", members)
    await engine.start(EnvironmentSpec("ann/map", spec(run=1).run, "token", ContainerData(group="g"), first))
    await engine.start(EnvironmentSpec("ann/plan", spec(run=2).run, "token", ContainerData(group="g"), second))
    for tag, address in members.items():
        process = process_of(world, f"ann/{tag}")
        addresses = within(process, "ip", "-4", "-o", "address")
        assert f"inet {address}/24" in addresses
        assert addresses.count("10.128.0.") == 2, "its own and the broadcast address"
        names = read(process, "etc/hosts")
        assert all(f"{member}\t{name}\n" in names for name, member in members.items())
    with listening(process_of(world, "ann/plan"), "10.128.0.7"):
        within(process_of(world, "ann/map"), "python3", "-c", REACH.format(address="10.128.0.7", port=PORT))


async def test_egress_follows_the_policy_of_the_user(world: SwarmWorld, engine: SwarmEngine) -> None:
    with socket.create_server((world.address, 0)) as server:
        program = REACH.format(address=world.address, port=server.getsockname()[1])
        for number, (egress, reached) in enumerate({"none": False, "internet": False, "all": True}.items()):
            await engine.start(replace(spec("ann/map", number), egress=egress))
            process = process_of(world, "ann/map")
            try:
                within(process, "python3", "-c", program)
                assert reached, egress
            except subprocess.CalledProcessError:
                assert not reached, egress
            assert ("default" in within(process, "ip", "route")) == (egress != "none")
    await engine.stop("ann/map")
    rules = within(world.node.process.pid, "iptables", "-S")
    assert "rce-" not in rules, "rules were not removed"


class QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture
def entry(world: SwarmWorld, tmp_path: Path) -> Iterator[tuple[Path, int]]:
    """A directory that is served by HTTP on the Master's host, and the port."""
    server = ThreadingHTTPServer((world.address, 0), lambda *words: QuietHandler(*words, directory=str(tmp_path)))
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    yield tmp_path, server.server_address[1]
    server.shutdown()
    thread.join()
    server.server_close()


async def test_packages_are_mounted_read_only(world: SwarmWorld, engine: SwarmEngine, entry: tuple[Path, int]) -> None:
    directory, port = entry
    (directory / "package.xml").write_text("<package/>")
    packed = io.BytesIO()
    archive.write([archive.Entry("demo/package.xml", directory / "package.xml", executable=False)], packed)
    (directory / "package").write_bytes(packed.getvalue())
    digest = archive.inspect(io.BytesIO(packed.getvalue())).digest

    async def ticket(asked: str) -> DownloadTicket:
        assert asked == digest
        return DownloadTicket("http", port, "/package", "token", len(packed.getvalue()))

    engine.request_ticket = ticket
    await engine.start(replace(with_options(), packages=[digest]))
    seen = world.inspect("ann/map")
    assert f"RCE_PACKAGE_PATH=/run/rce-packages/{digest}" in seen["Config"]["Env"]
    (mount,) = [each for each in seen["Mounts"] if each["Destination"] == "/run/rce-packages"]
    assert not mount["RW"]
    assert read(seen["State"]["Pid"], f"run/rce-packages/{digest}/demo/package.xml") == "<package/>"
