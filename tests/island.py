"""A machine for tests of networks: a network namespace with a dockerd in it that uses the packet filter there, and
another with those who live around it: a host of the internet, one of a private network, and a cloud's metadata.

So neither the daemon's rules nor ours touch this machine's. Who runs the tests often may keep such a daemon; then
DOCKER_HOST is its address and RCE_TEST_NAMESPACE the name of its namespace.
"""

from __future__ import annotations

import asyncio
import ctypes
import io
import os
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
from docker_daemon import NEEDED, copy_image, linked_images, private_daemon

from provisioning.image import BASE, MAPPING, Builder, add_file
from rce import __version__

CLONE_NEWNET = 0x40000000
IN_INTERNET, IN_PRIVATE, METADATA = "203.0.113.10", "172.30.7.10", "169.254.169.254"
OWN = ("203.0.113.1", "172.30.7.1", "169.254.1.1")  # the machine's addresses on those networks
PREFIXES = (24, 24, 16)
MPI_IMAGE = "rce-test/mpi"
MPI_DOCKERFILE = Path(__file__).with_name("ros") / "Mpi" / "image" / "Dockerfile"


class Island:
    """`host` is the Docker daemon's address; it is `kept` if it was there before the tests."""

    def __init__(self, host: str, namespace: str, kept: bool = False) -> None:
        self.kept = kept
        self.host = host
        self.namespace = namespace
        self.world = f"{namespace}-world"

    @contextmanager
    def inside(self) -> Iterator[None]:
        """This thread, its event loop's other threads, and all that they start are in the machine's network meanwhile,
        with its Docker."""
        loop = asyncio.get_running_loop()
        with entered(self.namespace), _variable("DOCKER_HOST", self.host):
            loop.set_default_executor(ThreadPoolExecutor())  # idle threads of before are where they were started
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
        run("ip", "netns", "delete", self.world)  # its end of the line goes with it, and so the other


@contextmanager
def entered(namespace: str) -> Iterator[None]:
    """This thread is in a network namespace meanwhile."""
    with open("/proc/thread-self/ns/net") as before, open(f"/run/netns/{namespace}") as there:
        _enter(there.fileno())
        try:
            yield
        finally:
            _enter(before.fileno())


def _enter(handle: int) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.setns(handle, CLONE_NEWNET):
        raise OSError(ctypes.get_errno(), "setns")


@contextmanager
def island(images: Callable[[], Any]) -> Iterator[Island]:
    """With the images of the Docker that `images` gives the API of. Skips the test where there can be none."""
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
    build_mpi_image(source)  # here, as nothing leads out of the island
    name = f"rce-test-{os.getpid()}"
    run("ip", "netns", "add", name)
    run("ip", "-n", name, "link", "set", "lo", "up")
    try:
        with tempfile.TemporaryDirectory(prefix="rce-island-", ignore_cleanup_errors=True) as directory:
            linked = linked_images(source, Path(directory) / "data")
            with private_daemon(Path(directory), namespace=name) as host:
                if not linked:
                    for name in (MAPPING, MPI_IMAGE):
                        copy_image(source, docker.APIClient(host, version="auto", timeout=600), f"{name}:{__version__}")
                yield Island(host, name)
    finally:
        run("ip", "netns", "delete", name)


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
