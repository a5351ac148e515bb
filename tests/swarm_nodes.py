"""Machines with Docker for the tests: a network namespace each, joined by a bridge, and in it a dockerd."""

from __future__ import annotations

import io
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import docker
import pytest
from docker.errors import DockerException
from numba.core.caching import _CacheLocator

from rce import __version__

ROOT = Path(__file__).parents[1]

_numbers = itertools.count()
START_TIMEOUT = 40.0
STOP_TIMEOUT = 40.0
HOST_IMAGE = "rce-test/host:1"  # nothing of its own: what runs in it sees this machine's Python
NEEDED = ("dockerd", "containerd", "runc", "iptables", "ip", "nsenter", "unshare")
# What a machine sees of its own: /run with Docker's usual socket, and Docker's directory at the path common to all.
SCRIPT = """
mount -t tmpfs none /run && mkdir -p /run/docker && mount --bind {own} {common} && mount --make-rshared / || exit 1
exec dockerd --data-root={common}/data --exec-root={common}/exec -H unix:///run/docker.sock \
    -H unix://{common}/docker.sock --pidfile={common}/pid --bridge=none --no-new-privileges \
    --insecure-registry={registry}
"""


@dataclass
class Node:
    """One machine; `host` is what DOCKER_HOST is for it."""

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
        """Pull its network plug."""
        run("ip", "link", "set", self.name, "down")

    def plug_in(self) -> None:
        run("ip", "link", "set", self.name, "up")

    def kill(self) -> None:
        """End its Docker daemon at once; the containers run on."""
        os.kill(int((self.directory / "pid").read_text()), signal.SIGKILL)
        self.process.wait(STOP_TIMEOUT)

    def power_off(self) -> None:
        """End what runs on it, also what a daemon that was killed has left."""
        for pid in inhabitants(self.name):
            os.kill(pid, signal.SIGKILL)


class Swarm:
    """Machines on one network; this process is on it too, at `address`."""

    def __init__(self, directory: Path) -> None:
        self.nodes: list[Node] = []
        self._directory = directory
        number = (os.getpid() + next(_numbers)) % 250
        self._bridge = f"rce{number}"
        self._net = f"10.{number}.87"
        self.address = f"{self._net}.1"

    def open(self) -> None:
        (self._directory / "docker").mkdir()
        run("ip", "link", "add", self._bridge, "type", "bridge")
        run("ip", "address", "add", f"{self.address}/24", "dev", self._bridge)
        run("ip", "link", "set", self._bridge, "up")

    def add(self) -> Node:
        number = len(self.nodes) + 1
        name, address = f"{self._bridge}n{number}", f"{self._net}.{number + 10}"
        own = self._directory / name
        own.mkdir()
        run("ip", "netns", "add", name)
        run("ip", "link", "add", name, "type", "veth", "peer", "name", "eth0", "netns", name)
        run("ip", "link", "set", name, "master", self._bridge, "up")
        for words in (f"address add {address}/24 dev eth0", "link set eth0 up", "link set lo up"):
            run("ip", "-n", name, *words.split())
        script = SCRIPT.format(own=own, common=self._directory / "docker", registry=f"{self.address}/32")
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
        """Until all answer."""
        until = time.monotonic() + START_TIMEOUT
        for node in self.nodes:
            while not answers(node.host):
                if node.process.poll() is not None or time.monotonic() > until:
                    last = "\n".join((node.directory / "log").read_text().splitlines()[-5:])
                    pytest.skip(f"a dockerd in a network namespace does not start here: {last}")
                time.sleep(0.1)

    def join(self) -> None:
        """Make one swarm of them; the first is its manager."""
        manager = self.nodes[0].api()
        quick = {"Dispatcher": {"HeartbeatPeriod": 1_000_000_000}}  # a node is down after three
        address = self.nodes[0].address
        manager.init_swarm(advertise_addr=address, listen_addr=f"{address}:2377", swarm_spec=quick)
        token = manager.inspect_swarm()["JoinTokens"]["Worker"]
        for node in self.nodes[1:]:
            node.api().join_swarm([f"{self.nodes[0].address}:2377"], token, advertise_addr=node.address)

    def close(self) -> None:
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


def inhabitants(namespace: str) -> list[int]:
    """The processes in a network namespace."""
    done = subprocess.run(["ip", "netns", "pids", namespace], stdout=subprocess.PIPE, text=True, check=True)
    return [int(word) for word in done.stdout.split()]


def host_mounts() -> list[str]:
    """What this Python and this checkout need of this machine."""
    base = Path(sys.executable).resolve().parents[1]
    places = {*("/usr", "/lib", "/lib64", "/etc/alternatives"), str(base), str(ROOT), str(Path(sys.prefix).resolve())}
    return sorted(path for path in places if Path(path).exists())


def load_host_image(node: Node, *, mapping: bool = False) -> None:
    """With `mapping` it has the compiled kernels, as `rce/mapping` has; else Numba would compile them in each."""
    layer = io.BytesIO()
    with tarfile.open(fileobj=layer, mode="w") as archive:
        if mapping:
            subprocess.run([sys.executable, "-P", "-c", "import rce.mapping.graph_mapper"], check=True)
            directory = ROOT / "rce" / "mapping"
            place = _CacheLocator.get_suitable_cache_subpath(str(directory / "graph_mapper.py"))  # type: ignore[no-untyped-call]
            for file in (directory / "__pycache__").glob("*.nb?"):
                archive.add(file, f"numba/{place}/{file.name}")
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
    """As many machines as that, in one swarm; skips the test where there can be none."""
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
