"""The engine `kubernetes` with a real cluster of one node: the contract, limits, and what happens to pods elsewhere."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import pytest

pytest.importorskip("kubernetes_asyncio", reason="needs kubernetes_asyncio: pip install '.[kubernetes]'")
pytest.importorskip("docker", reason="nodes of the tests need docker-py: pip install '.[docker]'")

from containers.endpoint import environment_user
from containers.kubernetes.engine import KubernetesEngine
from containers.kubernetes.objects import AGENT, SPEC, namespace_of
from rce.errors import LimitExceeded, NoCapacity, StartFailed
from rce.protocol.messages import Rates
from rce.protocol.slots import MB
from tests.support.containers.engine_contract import Endings, EngineContract, opened, spec, with_options
from tests.support.containers.kubernetes_world import KubernetesWorld
from tests.support.kubernetes.cluster import NAMESPACE


class TestKubernetesEngine(EngineContract):
    pass


async def test_requests_that_no_node_fulfils_are_refused(world: KubernetesWorld, engine: KubernetesEngine) -> None:
    with pytest.raises(NoCapacity, match=r"Insufficient nvidia\.com/gpu"):
        await engine.start(with_options(gpus=1))
    with pytest.raises(LimitExceeded):
        await engine.start(with_options(memory=2**60))
    with pytest.raises(StartFailed, match="rce-test/nothing:1"):
        await engine.start(with_options(image="rce-test/nothing:1"))
    assert world.remains() == set()


async def test_memory_is_limited(world: KubernetesWorld, endings: Endings) -> None:
    async with opened(world.engine(endings, "eat")) as engine:
        await engine.start(with_options(memory=32 * MB))
        ended = await endings.next()
        assert ended.status == -9
        assert "memory of 32 MB" in ended.reason
    assert world.remains() == set()


async def test_disk_and_rates_are_set_from_outside(world: KubernetesWorld, engine: KubernetesEngine) -> None:
    await engine.start(with_options(disk=16 * MB, bandwidth=MB, io=Rates(read=3 * MB, write=2 * MB)))
    process = world.process("ann/map")
    (home,) = [line.split() for line in mounts(process) if line.split()[1] == "/home/rce" and "ext4" in line]
    assert home[0].startswith("/dev/loop")
    assert owner(f"/proc/{process}/root/home/rce") == environment_user("ann/map")


def mounts(process: int) -> list[str]:
    return Path(f"/proc/{process}/mounts").read_text().splitlines()


def owner(path: str) -> int:
    return os.stat(path).st_uid


async def test_deleted_pod_is_reported(world: KubernetesWorld, engine: KubernetesEngine, endings: Endings) -> None:
    """As by `kubectl drain`."""
    await engine.start(spec())
    name = world.pod("ann/map")["metadata"]["name"]
    await asyncio.to_thread(world.cluster.kubectl, "delete", "pod", name, f"--namespace={NAMESPACE}", "--wait=false")
    ended = await endings.next()
    assert (ended.name, ended.run) == ("ann/map", spec().run)
    assert "as when a node is drained" in ended.reason
    assert world.remains() == set()


async def test_restarted_agent_serves_what_runs(
    world: KubernetesWorld, engine: KubernetesEngine, endings: Endings
) -> None:
    await engine.start(spec())
    sockets = world.places().control(spec().run) / "control.sock"
    before = inode(sockets)
    words = ("delete", "pod", f"--namespace={NAMESPACE}", f"--selector={AGENT}=yes")
    await asyncio.to_thread(world.cluster.kubectl, *words)
    async with asyncio.timeout(60):
        while inode(sockets) in (None, before):  # noqa: ASYNC110
            await asyncio.sleep(0.1)
    assert world.alive() == {"ann/map": spec().run}
    assert endings.none()
    async with asyncio.timeout(60):
        while "ann/map" not in await engine.usage():  # noqa: ASYNC110  # the agent has joined again
            await asyncio.sleep(0.1)


async def test_pod_with_a_malformed_annotation_is_removed(world: KubernetesWorld, endings: Endings) -> None:
    before = world.engine(endings)
    await before.open()
    try:
        await before.start(spec("ann/map", 1))
        await before.start(spec("bob/map", 2))
        for pod in [each["metadata"]["name"] for each in world.pods()]:
            words = ("annotate", "pod", pod, f"--namespace={NAMESPACE}", "--overwrite", f"{SPEC}={{")
            await asyncio.to_thread(world.cluster.kubectl, *words)
        await before.stop("ann/map")
        assert len(world.pods()) == 1
        assert endings.none()
    finally:
        await before.close()
    async with opened(world.engine(endings)) as engine:
        assert engine.running() == {}
        await engine.start(spec("bob/map", 3))
    assert world.remains() == set()


def inode(path: Path) -> int | None:
    return path.stat().st_ino if path.exists() else None


async def test_users_may_have_namespaces_of_their_own(world: KubernetesWorld, endings: Endings) -> None:
    async with opened(world.engine(endings, per_user=True)) as engine:
        await engine.start(spec("ann/map", 1))
        await engine.start(spec("bob/map", 2))
        namespaces = {world.pod(name)["metadata"]["namespace"] for name in ("ann/map", "bob/map")}
        assert namespaces == {namespace_of(NAMESPACE, name, per_user=True) for name in ("ann/map", "bob/map")}
        for namespace in namespaces:
            policies = world.cluster.get("networkpolicies", namespace=namespace)
            kinds = {each["metadata"]["name"].rpartition("-")[2] for each in policies}
            assert kinds == {"closed", "internet", "all", "listed"}
        await world.end("ann/map")
        assert (await endings.next()).name == "ann/map"
    assert world.remains() == set()
