"""World of the engine `kubernetes`: a cluster whose pods are seen through its API, and its containers by their ids."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from twisted.internet.base import ReactorBase

from containers.docker.setup import Setup
from containers.engine import Engine, EnvironmentEnded
from containers.kubernetes.engine import KubernetesEngine
from containers.kubernetes.objects import RUN, SPEC, TASK_SET, task_set_id
from containers.kubernetes.places import Places
from containers.kubernetes.process import first_process
from containers.kubernetes.setup import AgentSetup, ClusterSetup
from tests.support.containers.container_world import COMMAND, IMAGE
from tests.support.containers.engine_contract import CAPACITY, FEATURES, World
from tests.support.kubernetes.cluster import NAMESPACE, Cluster
from tests.support.swarm_nodes import HOST_IMAGE, host_mounts

RESET_TIMEOUT = 90.0  # seconds


class KubernetesWorld(World):
    def __init__(self, cluster: Cluster, directory: Path, reactor: ReactorBase) -> None:
        self.cluster = cluster
        self.directory = directory
        self._reactor = reactor

    def setup(self, *behaviour: str, image: str = "") -> Setup:
        return Setup(
            reactor=self._reactor,
            platform="machine",
            directory=self.directory,
            master=f"tcp:{self.cluster.address}:1",
            image=image or IMAGE,
            settings={"typesupport": "/types"},
            command=[*COMMAND, *behaviour],
        )

    def cluster_setup(self, **changes: Any) -> ClusterSetup:
        agent = AgentSetup(image=HOST_IMAGE, address=self.cluster.address, mounts=host_mounts())
        common = self.cluster.common
        given: dict[str, Any] = {
            "agent": agent,
            "namespace": NAMESPACE,
            "directory": f"{common}/rce",
            "seccomp": f"{common}/kubelet/seccomp",
        }
        return ClusterSetup(**{**given, **changes})

    def engine(
        self, ended: Callable[[EnvironmentEnded], None], *behaviour: str, image: str = "", **changes: Any
    ) -> KubernetesEngine:
        setup = self.setup(*behaviour, image=image)
        return KubernetesEngine(CAPACITY, FEATURES, ended, setup, cluster=self.cluster_setup(**changes))

    @property
    def task_set(self) -> str:
        return task_set_id(self.setup().labels)

    def break_start(self, engine: Engine) -> None:
        engine._setup = replace(engine._setup, command=["/nonexistent/program"])  # type: ignore[attr-defined]

    async def end(self, name: str) -> None:
        pod = self.pod(name)
        words = ("logs", pod["metadata"]["name"], f"--namespace={pod['metadata']['namespace']}")
        async with asyncio.timeout(60):
            while "ready" not in await asyncio.to_thread(self.cluster.kubectl, *words):  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        os.kill(self.process(name), signal.SIGUSR1)
        async with asyncio.timeout(60):
            while await asyncio.to_thread(self._is_running, name):  # noqa: ASYNC110
                await asyncio.sleep(0.1)

    def _is_running(self, name: str) -> bool:
        """Return True while Kubernetes takes an environment for running."""
        return any(name_of(each) == name and runs(each) for each in self.pods())

    def process(self, name: str) -> int:
        """Return the first process of an environment on this machine."""
        status = self.pod(name)["status"]["containerStatuses"][0]
        return first_process(status["containerID"].rpartition("//")[2])

    def pods(self) -> list[dict[str, Any]]:
        """Return the pods of environments of this task set."""
        words = ("get", "pods", "--all-namespaces", f"--selector={TASK_SET}={self.task_set},{RUN}", "--output=json")
        found: list[dict[str, Any]] = json.loads(self.cluster.kubectl(*words))["items"]
        return found

    def pod(self, name: str) -> dict[str, Any]:
        (found,) = [each for each in self.pods() if name_of(each) == name]
        return found

    def places(self, node: int = 0) -> Places:
        """Return the directories on a node as this machine sees them."""
        return Places.of(f"{self.cluster.nodes[node].directory}/rce", self.task_set)

    def directories(self) -> set[str]:
        """Return the runs that have a directory on any node."""
        found: set[str] = set()
        for number in range(len(self.cluster.nodes)):
            runs = self.places(number).runs
            found |= set(os.listdir(runs)) if runs.exists() else set()
        return found

    def remains(self) -> set[str]:
        """Return the names of all pods, and the runs of directories without one."""
        pods = self.pods()
        return {name_of(each) for each in pods} | self.directories() - {
            each["metadata"]["labels"][RUN] for each in pods
        }

    def alive(self) -> dict[str, str]:
        return {name_of(each): each["metadata"]["labels"][RUN] for each in self.pods() if runs(each)}

    def reset(self) -> None:
        """Remove what a failed test has left."""
        for pod in self.pods():
            metadata = pod["metadata"]
            words = (
                "pod",
                metadata["name"],
                f"--namespace={metadata['namespace']}",
                "--wait=false",
                "--grace-period=0",
            )
            self.cluster.kubectl("delete", *words, "--force", check=False)
        until = time.monotonic() + RESET_TIMEOUT
        while self.pods():
            assert time.monotonic() < until, "pods of an earlier test do not end"
            time.sleep(0.2)


def name_of(pod: dict[str, Any]) -> str:
    return str(json.loads(pod["metadata"]["annotations"][SPEC])["name"])


def runs(pod: dict[str, Any]) -> bool:
    states = pod["status"].get("containerStatuses") or [{}]
    return "running" in states[0].get("state", {}) and "deletionTimestamp" not in pod["metadata"]
