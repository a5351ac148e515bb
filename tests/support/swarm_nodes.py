"""Machines of a Docker Swarm for the tests: network namespaces with a dockerd each, connected by a bridge."""

from __future__ import annotations

import io
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import docker
import pytest
from docker.errors import DockerException
from numba.core.caching import _CacheLocator

from rce import __version__
from tests.support.paths import ROOT

# Of bridges and their networks 10.NUMBER.87.0/24, apart from those of Swarm (10.0) and the platform (10.127, 10.128).
NUMBERS = range(20, 120)
START_TIMEOUT = 120.0
STOP_TIMEOUT = 120.0
HOST_IMAGE = "rce-test/host:1"  # an almost empty image; containers see the Python of this machine by mounts
NEEDED = ("dockerd", "containerd", "runc", "iptables", "ip", "nsenter", "unshare")
# Each machine has its own /run, with Docker's usual socket, and its own Docker directory at a path common to all.
SCRIPT = """
mount -t tmpfs none /run && mkdir -p /run/docker && mount --bind {own} {common} && mount --make-rshared / || exit 1
exec dockerd --data-root={common}/data --exec-root={common}/exec -H unix:///run/docker.sock \
    -H unix://{common}/docker.sock --pidfile={common}/pid --no-new-privileges {options}
"""


@dataclass
class Node:
    """One machine; `host` is its DOCKER_HOST."""

    name: str
    address: str
    directory: Path
    process: subprocess.Popen[bytes]

    @property
    def host(self) -> str:
        return f"unix://{self.directory}/docker.sock"

    def api(self, timeout: float = 60) -> docker.APIClient:
        return docker.APIClient(base_url=self.host, version="auto", timeout=timeout)

    def cut_off(self) -> None:
        """Disconnect its network."""
        run("ip", "link", "set", self.name, "down")

    def plug_in(self) -> None:
        """Connect its network again."""
        run("ip", "link", "set", self.name, "up")

    def kill(self) -> None:
        """Kill its Docker daemon; the containers keep running."""
        os.kill(int((self.directory / "pid").read_text()), signal.SIGKILL)
        self.process.wait(STOP_TIMEOUT)

    def power_off(self) -> None:
        """Kill all of its processes, including those that a killed daemon has left."""
        for pid in processes_in(self.name):
            with suppress(ProcessLookupError):  # a process may end with another one
                os.kill(pid, signal.SIGKILL)


class Swarm:
    """Machines on one network; this machine is on it too, at `address`."""

    def __init__(self, directory: Path) -> None:
        self.nodes: list[Node] = []
        self.address = ""
        self.directory = directory
        self.net = ""  # the first two bytes of all addresses
        self._bridge = ""

    def open(self) -> None:
        """Create the bridge, with a number that no other test run uses."""
        (self.directory / "docker").mkdir()
        for number in random.sample(NUMBERS, len(NUMBERS)):
            self._bridge, self.net = f"rce{number}", f"10.{number}"
            self.address = f"{self.net}.87.1"
            if not routed(f"{self.net}.87.0/24") and created("ip", "link", "add", self._bridge, "type", "bridge"):
                break
        else:
            pytest.skip(f"all {len(NUMBERS)} bridges for swarms of tests are in use: delete those that are left")
        run("ip", "address", "add", f"{self.address}/24", "dev", self._bridge)
        run("ip", "link", "set", self._bridge, "up")

    def add(self, *options: str) -> Node:
        """Start a machine, whose Docker has these options, by default those for a swarm; it may not answer yet."""
        number = len(self.nodes) + 1
        name, address = f"{self._bridge}n{number}", f"{self.net}.87.{number + 10}"
        own = self.directory / name
        own.mkdir()
        run("ip", "netns", "add", name)
        run("ip", "link", "add", name, "type", "veth", "peer", "name", "eth0", "netns", name)
        run("ip", "link", "set", name, "master", self._bridge, "up")
        for words in (f"address add {address}/24 dev eth0", "link set eth0 up", "link set lo up"):
            run("ip", "-n", name, *words.split())
        words = " ".join(options or ("--bridge=none", f"--insecure-registry={self.address}/32"))
        script = SCRIPT.format(own=own, common=self.directory / "docker", options=words)
        with (own / "log").open("w") as log:
            process = subprocess.Popen(
                ["nsenter", f"--net=/run/netns/{name}", "unshare", "-m", "sh", "-c", script],
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        node = Node(name, address, own, process)
        self.nodes.append(node)
        return node

    def wait(self) -> None:
        """Wait until all daemons answer; skip the test if one does not start."""
        until = time.monotonic() + START_TIMEOUT
        for node in self.nodes:
            while not answers(node.host):
                if node.process.poll() is not None or time.monotonic() > until:
                    last = "\n".join((node.directory / "log").read_text().splitlines()[-5:])
                    pytest.skip(f"a dockerd in a network namespace does not start here: {last}")
                time.sleep(0.1)

    def join(self) -> None:
        """Make a swarm of all machines; the first is its manager."""
        manager = self.nodes[0].api()
        quick = {"Dispatcher": {"HeartbeatPeriod": 1_000_000_000}}  # a node is down after three missed heartbeats
        address = self.nodes[0].address
        manager.init_swarm(advertise_addr=address, listen_addr=f"{address}:2377", swarm_spec=quick)
        token = manager.inspect_swarm()["JoinTokens"]["Worker"]
        for node in self.nodes[1:]:
            node.api().join_swarm([f"{self.nodes[0].address}:2377"], token, advertise_addr=node.address)

    def close(self) -> None:
        """Stop all machines and delete the bridge."""
        for node in self.nodes:
            self._end(node)
        run("ip", "link", "delete", self._bridge)

    def _end(self, node: Node) -> None:
        node.plug_in()
        if node.process.poll() is None:
            node.process.terminate()
            node.process.wait(STOP_TIMEOUT)
        node.power_off()
        run("ip", "netns", "delete", node.name)


def routed(network: str) -> bool:
    """Return True if this machine has a route, other than a default route, that overlaps with a network."""
    shown = [
        subprocess.check_output(["ip", "-4", "route", "show", how, network], text=True) for how in ("match", "root")
    ]
    return any(not line.startswith("default") for line in "".join(shown).splitlines())


def created(*words: str) -> bool:
    """Run a command that fails if what it creates exists; return False if it failed."""
    return subprocess.run(words, check=False, capture_output=True).returncode == 0


def processes_in(namespace: str) -> list[int]:
    """Return the processes in a network namespace."""
    done = subprocess.run(["ip", "netns", "pids", namespace], stdout=subprocess.PIPE, text=True, check=True)
    return [int(word) for word in done.stdout.split()]


def host_mounts() -> list[str]:
    """Return the directories of this machine that this Python and this checkout need."""
    base = Path(sys.executable).resolve().parents[1]
    paths = {*("/usr", "/lib", "/lib64", "/etc/alternatives"), str(base), str(ROOT), str(Path(sys.prefix).resolve())}
    return sorted(path for path in paths if Path(path).exists())


def load_host_image(node: Node, *, mapping: bool = False) -> None:
    """Import HOST_IMAGE into a node's daemon.

    With `mapping` it contains the compiled Numba kernels, as the image `rce/mapping` does, which would else be compiled
    in each environment.
    """
    layer = io.BytesIO()
    with tarfile.open(fileobj=layer, mode="w") as archive:
        note = tarfile.TarInfo("README")  # kubelet takes an image without any bytes for broken
        note.size = 3
        archive.addfile(note, io.BytesIO(b"RCE"))
        if mapping:
            subprocess.run([sys.executable, "-P", "-c", "import rce.mapping.mappers"], check=True)
            for file in (ROOT / "rce" / "mapping").rglob("__pycache__/*.nb?"):
                module = file.parents[1] / "module.py"  # only its directory counts
                subpath = _CacheLocator.get_suitable_cache_subpath(str(module))  # type: ignore[no-untyped-call]
                archive.add(file, f"numba/{subpath}/{file.name}")
    changes = [
        f"ENV PATH={Path(sys.executable).parent}:/usr/bin:/bin PYTHONDONTWRITEBYTECODE=1 NUMBA_CACHE_DIR=/tmp/numba",
        f"LABEL rce.version={__version__}",
    ]
    if mapping:
        words = ["/usr/bin/sh", "-c", 'cp -r /numba /tmp/numba && exec "$@"', "sh"]
        changes.append(f"ENTRYPOINT {json.dumps(words)}")
    name, _, tag = HOST_IMAGE.partition(":")
    node.api().import_image_from_data(layer.getvalue(), repository=name, tag=tag, changes=changes)


@contextmanager
def swarm_of(count: int) -> Iterator[Swarm]:
    """Make a swarm of `count` machines; skip the test where this is impossible."""
    lacking = [name for name in NEEDED if shutil.which(name, path=os.environ["PATH"] + ":/usr/sbin:/sbin") is None]
    if lacking:
        pytest.skip(f"no {', '.join(lacking)}: install docker.io, containerd, runc, iptables and iproute2")
    if os.geteuid() != 0:
        pytest.skip("network namespaces need root: run the tests as root")
    with tempfile.TemporaryDirectory(prefix="rce-swarm-", ignore_cleanup_errors=True) as directory:
        made = Swarm(Path(directory))
        made.open()
        try:
            for _ in range(count):
                made.add()
            made.wait()
            made.join()
            yield made
        finally:
            made.close()


def run(*words: str) -> None:
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)


def answers(host: str) -> bool:
    try:
        return bool(docker.APIClient(base_url=host, version="auto", timeout=10).ping())
    except (DockerException, OSError):
        return False
