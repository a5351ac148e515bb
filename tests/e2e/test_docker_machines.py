"""Several machines with the engine `docker`, each with a Docker daemon and a network of its own: the uses of two of
them, one cut off from the network, and one whose daemon is killed, under traffic."""

from __future__ import annotations

import os
import signal
from collections.abc import AsyncIterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from machines import Machines
from namespaces import Network, network
from real_platform import until
from test_kills import Traffic, next_event
from test_machines import NOTICED, gone_under_traffic, made, use_case_1

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

import docker
from docker_daemon import copy_image, linked_images, private_daemon

from provisioning.image import MAPPING
from rce import __version__
from rce.errors import StartFailed
from rce.messages import EnvironmentEvent

PACKAGES = Path(__file__).parent / "ros"
HOSTS = ("a", "b")


class Dockers:
    """A Docker daemon on each machine, with the images of the usual one; until the stack is closed."""

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
        """Also after a kill."""
        daemon = private_daemon(self._directory / name, self._wires.space(name), self._shim(name))
        self.hosts[name] = self._stack.enter_context(daemon)

    def kill(self, name: str) -> None:
        """At once. Containers run on."""
        pid = int((self._directory / name / "pid").read_text())
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        # Its containerd goes with it, which the next daemon would not believe where nobody collects the dead.
        (self._directory / name / "exec" / "containerd" / "containerd.pid").unlink()

    def _shim(self, name: str) -> int:
        """The process by which a container outlives the daemon; 0 without one."""
        shims = [pid for pid in self._wires.pids(name) if b"shim" in Path(f"/proc/{pid}/cmdline").read_bytes()]
        return shims[0] if shims else 0


Site = tuple[Machines, Network, Dockers]


@pytest.fixture(scope="module")
async def site(images: Any, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Site]:
    with ExitStack() as stack:
        wires = stack.enter_context(network(*HOSTS))
        own = stack.enter_context(TemporaryDirectory(prefix="rce-dockers-", ignore_cleanup_errors=True))
        dockers = Dockers(stack, wires, Path(own), images)
        arguments = ["--engine=docker", f"--package-path={PACKAGES}"]
        async with made(wires, tmp_path_factory.mktemp("machines"), arguments, dockers=dockers.hosts) as machines:
            yield machines, wires, dockers
        for name in HOSTS:
            assert dockers.api(name).containers(all=True) == []


async def test_use_case_1_in_containers(site: Site) -> None:
    machines, _, _ = site
    await use_case_1(machines)


async def test_a_machine_that_is_cut_off_under_traffic(site: Site) -> None:
    machines, wires, _ = site
    await gone_under_traffic(machines, wires, "cut", own_types=False)


async def test_a_docker_that_is_killed_under_traffic(site: Site) -> None:
    """The environment works on. Who wants another on that machine hears why not. The next daemon ends the container, as
    Docker does, and the environment gets a new life."""
    machines, _, dockers = site
    async with machines.robot("one") as robot, robot.environment("lasting", special_features=["a"]) as lasting:
        traffic = Traffic(robot, lasting, own_types=False)
        await traffic.start()
        events = robot.events()
        dockers.kill("a")
        await traffic.flows()
        with pytest.raises(StartFailed, match="Docker does not answer"):
            await robot.create_environment("refused", special_features=["a"])
        await traffic.flows()
        dockers.start("a")
        assert (await next_event(events, EnvironmentEvent, "lost")).containerTag == "lasting"
        assert (await next_event(events, EnvironmentEvent, "ready")).containerTag == "lasting"
        await traffic.flows(NOTICED)
        await until(lambda: len(dockers.api("a").containers(all=True)) == 1, what="the old container is removed")
        await traffic.stop()
