"""Several machines with the engine `docker`, each with its own Docker daemon and network.

Tests use two of them together, disconnect one from the network, and kill the daemon of one, all under traffic.
"""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import AsyncIterator
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from rce.bench.network.bridge import Network
from tests.support.e2e.machines import Machines
from tests.support.e2e.namespaces import network
from tests.support.e2e.real_platform import until
from tests.support.e2e.traffic import Traffic, next_event
from tests.support.e2e.use_cases import FAILOVER_TIMEOUT, check_failover_under_traffic, platform_on, use_case_1
from tests.support.paths import TESTS

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

import docker

from provisioning.image import MAPPING
from rce import __version__
from rce.errors import StartFailed
from rce.protocol.messages import EnvironmentEvent
from tests.support.docker_daemon import copy_image, linked_images, private_daemon

PACKAGES = TESTS / "e2e" / "ros"
HOSTS = ("a", "b")


class Dockers:
    """Docker daemons of all machines, with the images of the usual daemon; they end when the stack is closed."""

    def __init__(self, stack: ExitStack, wires: Network, directory: Path, images: Any) -> None:
        self._stack, self._wires, self._directory = stack, wires, directory
        self.hosts: dict[str, str] = {}
        for name in HOSTS:
            (directory / name).mkdir()
            linked = linked_images(images, directory / name / "data")
            self.start(name)
            if not linked:
                copy_image(images, self.api(name), f"{MAPPING}:{__version__}")

    def api(self, name: str) -> Any:
        return docker.APIClient(self.hosts[name], version="auto", timeout=60)

    def start(self, name: str) -> None:
        """Start the daemon of a machine, also after it was killed."""
        daemon = private_daemon(self._directory / name, self._wires.space(name), self._shim(name))
        self.hosts[name] = self._stack.enter_context(daemon)

    def kill(self, name: str) -> None:
        """Kill the daemon of a machine; its containers keep running."""
        pid = int((self._directory / name / "pid").read_text())
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        # Its containerd ends with it, but may remain as a zombie, which the next daemon would take for a running one.
        (self._directory / name / "exec" / "containerd" / "containerd.pid").unlink()

    def _shim(self, name: str) -> int:
        """Return a process by which a container survives the daemon; 0 if there is none."""
        for pid in self._wires.pids(name):
            with suppress(OSError):  # it has ended meanwhile
                if b"shim" in Path(f"/proc/{pid}/cmdline").read_bytes():
                    return pid
        return 0


Site = tuple[Machines, Network, Dockers]


@pytest.fixture(scope="module")
async def site(images: Any, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Site]:
    with ExitStack() as stack:
        wires = stack.enter_context(network(*HOSTS))
        own = stack.enter_context(TemporaryDirectory(prefix="rce-dockers-", ignore_cleanup_errors=True))
        dockers = Dockers(stack, wires, Path(own), images)
        arguments = ["--engine=docker", f"--package-path={PACKAGES}"]
        directory = tmp_path_factory.mktemp("machines")
        async with platform_on(wires, directory, arguments, dockers=dockers.hosts) as machines:
            yield machines, wires, dockers
        for name in HOSTS:
            assert dockers.api(name).containers(all=True) == []


async def test_use_case_1_in_containers(site: Site) -> None:
    machines, _, _ = site
    await use_case_1(machines)


async def test_environment_moves_from_a_disconnected_machine(site: Site) -> None:
    machines, wires, _ = site
    await check_failover_under_traffic(machines, wires, "cut", own_types=False)


async def test_environment_survives_a_killed_docker_daemon(site: Site) -> None:
    """The environment works on, and starting another one on that machine fails with the reason.

    The next daemon ends the container, as Docker does, and the environment is restarted.
    """
    machines, _, dockers = site
    async with machines.robot("one") as robot, robot.environment("lasting", special_features=["a"]) as lasting:
        traffic = Traffic(robot, lasting, own_types=False)
        await traffic.start()
        events = robot.events()
        dockers.kill("a")
        await traffic.wait_for_round_trip()
        with pytest.raises(StartFailed, match="Docker does not answer"):
            await robot.create_environment("refused", special_features=["a"])
        await traffic.wait_for_round_trip()
        await asyncio.to_thread(dockers.start, "a")  # the robot goes on meanwhile
        assert (await next_event(events, EnvironmentEvent, "lost")).containerTag == "lasting"
        assert (await next_event(events, EnvironmentEvent, "ready")).containerTag == "lasting"
        await traffic.wait_for_round_trip(FAILOVER_TIMEOUT)
        await until(lambda: len(dockers.api("a").containers(all=True)) == 1, what="the old container is removed")
        await traffic.stop()
