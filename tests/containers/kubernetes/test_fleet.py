"""Nodes and agents, with an API in memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from twisted.internet.base import ReactorBase

pytest.importorskip("kubernetes_asyncio", reason="needs kubernetes_asyncio: pip install '.[kubernetes]'")

from containers.agents.connections import AgentAccess
from containers.kubernetes import fleet as module
from containers.kubernetes.fleet import Fleet
from containers.kubernetes.objects import Object
from containers.kubernetes.setup import AgentSetup, ClusterSetup
from containers.limits import Size
from rce.errors import InvalidRequest, Unavailable
from tests.support.kubernetes.fake_api import FakeApi, thing

NODES, PODS = "/api/v1/nodes", "/api/v1/namespaces/rce/pods"


def node(name: str, ready: str = "True", cpu: str = "2", **labels: str) -> Object:
    found = thing(name)
    found["metadata"]["labels"] = {f"rce.feature/{feature}": "true" for feature in labels}
    conditions = [{"type": "Ready", "status": ready}]
    return {**found, "status": {"conditions": conditions, "allocatable": {"cpu": cpu, "memory": "1Gi"}}}


def fleet(api: FakeApi, directory: Path, address: str = "10.0.0.1") -> Fleet:
    cluster = ClusterSetup(agent=AgentSetup(image="rce/agent:1", address=address))
    return Fleet(api, cluster, "t", ["camera"], directory / "kubernetes.json", lambda name: None)


async def opened(made: Fleet, reactor: ReactorBase, master: str = "tcp:10.0.0.1:8080") -> None:
    await made.open(reactor, master, None, lambda node: None, lambda handlers: None)


async def test_lost_nodes_do_not_count(tmp_path: Path, reactor: ReactorBase, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "AGENTS_TIMEOUT", 0.01)
    api = FakeApi({NODES: [node("n1", arm="true"), node("n2", "Unknown", "8", gpu="true")], PODS: []})
    made = fleet(api, tmp_path)
    with pytest.raises(Unavailable, match=r"no agent .* has joined \(none was started\).*kubectl describe"):
        await opened(made, reactor)
    assert set(made.usable) == {"n1"}
    assert made.features == {"camera", "arm"}
    assert made.largest == Size(2.0, 2**30)
    await made.close()


async def test_agents_get_secret_and_address_which_stay_the_same(
    tmp_path: Path, reactor: ReactorBase, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "AGENTS_TIMEOUT", 0.01)
    addresses: list[Any] = []
    for _ in range(2):
        api = FakeApi({NODES: [], PODS: []})
        made = fleet(api, tmp_path)
        await opened(made, reactor)  # a cluster without nodes
        await made.close()
        daemonset = api.objects["/apis/apps/v1/namespaces/rce/daemonsets/rce-agent-t"]
        (container,) = daemonset["spec"]["template"]["spec"]["containers"]
        addresses += [each["value"] for each in container["env"] if each["name"] == "RCE_TASK_SET"]
    port = AgentAccess.load(tmp_path / "kubernetes.json").port
    assert addresses == [f"tcp:10.0.0.1:{port}"] * 2


async def test_reason_of_a_failed_agent_is_in_the_error(
    tmp_path: Path, reactor: ReactorBase, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "AGENTS_TIMEOUT", 0.01)
    waiting = {"waiting": {"reason": "ErrImagePull", "message": "no such image"}}
    pod = {**thing("p"), "spec": {"nodeName": "n1"}, "status": {"containerStatuses": [{"state": waiting}]}}
    pod["metadata"]["namespace"] = "rce"
    made = fleet(FakeApi({NODES: [node("n1")], PODS: [pod]}), tmp_path)
    with pytest.raises(Unavailable, match="ErrImagePull: no such image"):
        await opened(made, reactor)
    await made.close()


@pytest.mark.parametrize(
    ("master", "address", "field"), [("tcp:127.0.0.1:1", "10.0.0.1", "master"), ("tcp:10.0.0.1:1", "", "agent_address")]
)
async def test_addresses_that_nodes_cannot_reach_are_refused(
    master: str, address: str, field: str, tmp_path: Path, reactor: ReactorBase
) -> None:
    with pytest.raises(InvalidRequest) as error:
        await opened(fleet(FakeApi(), tmp_path, address), reactor, master)
    assert error.value.field == field


async def test_removed_agents_leave_neither_daemonset_nor_secret(tmp_path: Path) -> None:
    api = FakeApi()
    await fleet(api, tmp_path).remove_agents()
    assert [step.split("/")[-2] for step in api.steps] == ["daemonsets", "secrets"]
