"""Island: a machine for tests of networks, separate from the network of this machine.

It is a network namespace with a dockerd, which uses the packet filter there. A second namespace, its *world*, has a
host of the internet, one of a private network, and a cloud's metadata service. So neither Docker's packet filter rules
nor those of the platform affect this machine.

To save the time for starting a daemon and copying images, developers can keep one running: DOCKER_HOST is then its
address and RCE_TEST_NAMESPACE the name of its namespace.
"""

from __future__ import annotations

import asyncio
import io
import os
import secrets
import shutil
import subprocess
import tarfile
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import docker
import pytest

from provisioning.image import BASE, MAPPING, Builder, add_file
from rce import __version__
from rce.bench.network.namespaces import entered
from tests.support.docker_daemon import NEEDED, copy_image, linked_images, private_daemon
from tests.support.paths import ROS_PACKAGES

IN_INTERNET, IN_PRIVATE, METADATA = "203.0.113.10", "172.30.7.10", "169.254.169.254"
OWN = ("203.0.113.1", "172.30.7.1", "169.254.1.1")  # addresses of the island on those networks
PREFIXES = (24, 24, 16)
MPI_IMAGE = "rce-test/mpi"
MPI_DOCKERFILE = ROS_PACKAGES / "Mpi" / "image" / "Dockerfile"


class Island:
    """Island whose Docker daemon has the address `host`; `kept` if it ran before the tests."""

    def __init__(self, host: str, namespace: str, kept: bool = False) -> None:
        self.kept = kept
        self.host = host
        self.namespace = namespace
        self.world = f"{namespace}-world"

    @contextmanager
    def inside(self) -> Iterator[None]:
        """Move this thread, the threads of its event loop, and the processes they start to the island during the block.

        DOCKER_HOST is the island's daemon meanwhile.
        """
        loop = asyncio.get_running_loop()
        with entered(self.namespace), _variable("DOCKER_HOST", self.host):
            loop.set_default_executor(ThreadPoolExecutor())  # existing threads stay in the namespace they started in
            yield
        loop.set_default_executor(ThreadPoolExecutor())

    def open_world(self) -> None:
        run("ip", "netns", "add", self.world)
        run("ip", "link", "add", "world", "netns", self.namespace, "type", "veth", *peer("eth0", self.world))
        for namespace, device, addresses in (
            (self.namespace, "world", OWN),
            (self.world, "eth0", (IN_INTERNET, IN_PRIVATE, METADATA)),
        ):
            for address, prefix in zip(addresses, PREFIXES, strict=True):
                run("ip", "-n", namespace, "address", "add", f"{address}/{prefix}", "dev", device)
            for each in ("lo", device):
                run("ip", "-n", namespace, "link", "set", each, "up")

    def close_world(self) -> None:
        run("ip", "netns", "delete", self.world)  # deletes both ends of the veth pair too


@contextmanager
def island(images: Callable[[], Any]) -> Iterator[Island]:
    """Make an island with the images of the daemon whose API `images` returns; skip the test if that is impossible."""
    lacking = [name for name in (*NEEDED, "ip", "nsenter", "unshare") if not _has(name)]
    if lacking:
        pytest.skip(f"no {', '.join(lacking)}: install docker.io, containerd, runc, iptables and iproute2")
    if os.geteuid() != 0:
        pytest.skip("network namespaces need root: run the tests as root")
    with _machine(images) as made:
        made.open_world()
        try:
            yield made
        finally:
            made.close_world()


@contextmanager
def _machine(images: Callable[[], Any]) -> Iterator[Island]:
    kept = os.environ.get("RCE_TEST_NAMESPACE", "")
    if kept:
        yield Island(os.environ["DOCKER_HOST"], kept, kept=True)
        return
    source = images()
    build_mpi_image(source)  # here, as a build on the island could not download anything
    namespace = f"rce-test-{secrets.token_hex(4)}"  # a killed test run may have left others
    run("ip", "netns", "add", namespace)
    run("ip", "-n", namespace, "link", "set", "lo", "up")
    try:
        with tempfile.TemporaryDirectory(prefix="rce-island-", ignore_cleanup_errors=True) as directory:
            linked = linked_images(source, Path(directory) / "data")
            with private_daemon(Path(directory), namespace=namespace) as host:
                if not linked:
                    for image in (MAPPING, MPI_IMAGE):
                        target = docker.APIClient(host, version="auto", timeout=600)
                        copy_image(source, target, f"{image}:{__version__}")
                        target.close()
                yield Island(host, namespace)
    finally:
        run("ip", "netns", "delete", namespace)


def build_mpi_image(api: docker.APIClient) -> None:
    context = io.BytesIO()
    with tarfile.open(fileobj=context, mode="w") as archive:
        add_file(archive, MPI_DOCKERFILE, "Dockerfile")
    base = f"{BASE}:{__version__}"
    Builder(api).make(context.getvalue(), "Dockerfile", f"{MPI_IMAGE}:{__version__}", {"BASE": base})


@contextmanager
def _variable(name: str, value: str) -> Iterator[None]:
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def peer(device: str, namespace: str) -> tuple[str, ...]:
    return "peer", "name", device, "netns", namespace


def _has(program: str) -> bool:
    return shutil.which(program, path=os.environ["PATH"] + ":/usr/sbin:/sbin") is not None


def run(*words: str) -> None:
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
