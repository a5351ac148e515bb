"""Namespaces, policies and pull secrets, with an API in memory."""

from __future__ import annotations

import pytest

pytest.importorskip("kubernetes_asyncio", reason="needs kubernetes_asyncio: pip install '.[kubernetes]'")

from containers.kubernetes.namespaces import Namespaces
from containers.kubernetes.setup import AgentSetup, ClusterSetup
from rce.control.calls.environments import Group
from tests.support.kubernetes.fake_api import FakeApi

AGENT = AgentSetup(image="rce/agent:1", address="task-set")
SECRET = "/api/v1/namespaces/rce/secrets/registry"
GROUP = Group("ann/pair", "10.128.0.0/24", "10.128.0.2")


async def test_given_namespace_gets_policies_once() -> None:
    api = FakeApi()
    namespaces = Namespaces(api, ClusterSetup(agent=AGENT), "t")
    assert namespaces.pods == "/api/v1/namespaces/rce/pods"
    for _ in range(2):
        await namespaces.prepare("rce", None)
    place = "apply /apis/networking.k8s.io/v1/namespaces/rce/networkpolicies"
    assert api.steps == [f"{place}/rce-t-{name}" for name in ("closed", "internet", "all", "listed")]


async def test_group_has_a_policy_of_its_own() -> None:
    api = FakeApi()
    await Namespaces(api, ClusterSetup(agent=AGENT), "t").prepare("rce", GROUP)
    assert "rce-t-group-" in api.steps[-1]


async def test_namespace_of_a_user_is_created_with_the_pull_secrets() -> None:
    api = FakeApi()
    api.objects[SECRET] = {"type": "kubernetes.io/dockerconfigjson", "data": {".dockerconfigjson": "e30="}}
    namespaces = Namespaces(api, ClusterSetup(agent=AGENT, per_user=True, pull_secrets=["registry"]), "t")
    assert namespaces.pods == "/api/v1/pods"
    await namespaces.prepare("rce-ann", None)
    assert api.steps[:2] == ["apply /api/v1/namespaces/rce-ann", "apply /api/v1/namespaces/rce-ann/secrets/registry"]
    assert api.objects["/api/v1/namespaces/rce-ann/secrets/registry"]["data"] == api.objects[SECRET]["data"]


async def test_missing_pull_secret_is_passed_over() -> None:
    api = FakeApi()
    namespaces = Namespaces(api, ClusterSetup(agent=AGENT, per_user=True, pull_secrets=["registry"]), "t")
    await namespaces.prepare("rce-ann", None)
    assert not any("secrets" in step for step in api.steps)
