"""The manager of a swarm, whose API is a stand-in: what is read from its answers, and its errors."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from docker.errors import APIError, ImageNotFound, NotFound

from containers.swarm import manager as module
from containers.swarm.manager import Found, Manager, Network, Node, _node, _node_of_started
from rce import __version__
from rce.errors import InvalidRequest, NoCapacity, StartFailed, TimedOut, Unavailable

LABELS = {"rce.platform": "machine"}
RUN = "1" * 32
AGENTS = {**LABELS, "rce.agent": "yes"}


def service(name: str, **labels: str) -> dict[str, Any]:
    own = {"rce.environment": "ann/map", "rce.run": RUN, "rce.size": "2"}
    return {"Spec": {"Name": name, "Labels": {**LABELS, **own, **{f"rce.{key}": labels[key] for key in labels}}}}


def task(state: str, node: str = "", **status: str) -> dict[str, Any]:
    return {"Status": {"State": state, "Message": "", **status}, **({"NodeID": node} if node else {})}


class Api:
    """Docker's API of a manager; `tasks` has the answers to one query after the other, the last of which stays."""

    def __init__(self) -> None:
        self.created: list[str] = []
        self.updated: list[dict[str, Any]] = []
        self.found: list[dict[str, Any]] = []
        self.tasks_of: list[list[dict[str, Any]]] = [[]]
        self.present: list[str] = []
        self.service_labels: dict[str, str] | None = None
        self.image: Any = None
        self.refusal: Exception | None = None

    def services(self, **_: Any) -> list[dict[str, Any]]:
        return self.found

    def tasks(self, **_: Any) -> list[dict[str, Any]]:
        return self.tasks_of.pop(0) if len(self.tasks_of) > 1 else self.tasks_of[0]

    def networks(self, names: list[str] | None = None, **_: Any) -> list[dict[str, str]]:
        return [{"Name": name} for name in self.present if names is None or name in names]

    def create_network(self, name: str, **options: Any) -> None:
        self.present.append(name)
        self.created.append(f"network {name}, {'internal' if options['internal'] else 'open'}")

    def remove_network(self, name: str) -> None:
        if self.refusal is not None:
            raise self.refusal
        self.present.remove(name)

    def create_service(self, task: Any, name: str, labels: dict[str, str], mode: dict[str, Any], **_: Any) -> None:
        if self.refusal is not None:
            raise self.refusal
        self.created.append(f"service {name}, {', '.join(mode)}")

    def update_service(self, service: str, version: int, task: Any, *_: Any, **__: Any) -> None:
        self.updated.append(task)

    def inspect_service(self, name: str) -> dict[str, Any]:
        if self.service_labels is None:
            raise NotFound("no such service")
        return {"ID": "id", "Version": {"Index": 7}, "Spec": {"Labels": self.service_labels}}

    def remove_service(self, name: str) -> None:
        raise NotFound("no such service")

    def inspect_image(self, tag: str) -> dict[str, Any]:
        if self.image is None:
            raise ImageNotFound("no such image")
        return {"Id": "sha256:1", "Config": {"Labels": self.image}}

    def get_image(self, image: str) -> Any:
        raise OSError("No space left on device")


@pytest.fixture
def api() -> Api:
    return Api()


@pytest.fixture
def manager(api: Api, monkeypatch: pytest.MonkeyPatch) -> Manager:
    monkeypatch.setattr(module, "POLL_INTERVAL", 0)
    manager = Manager(LABELS)
    manager._api = api
    return manager


# --- services ---------------------------------------------------------------------------------------------------------


async def test_services_are_read_from_their_labels(manager: Manager, api: Api) -> None:
    api.found = [service("rce-1"), service("rce-2", group="rce-group"), service("rce-3")]
    api.tasks_of = [[task("running", "n1")], [task("preparing", "n2")], []]
    assert await manager.present() == [
        Found("rce-1", "ann/map", RUN, 2, network="rce-1", node="n1", running=True),
        Found("rce-2", "ann/map", RUN, 2, network="rce-group", node="n2", running=False),
        Found("rce-3", "ann/map", RUN, 2, network="rce-3", node="", running=False),
    ]


async def test_service_gets_an_internal_network_of_its_own(manager: Manager, api: Api) -> None:
    await manager.create_service("rce-1", {}, {}, Network("rce-1"))
    assert api.created == ["network rce-1, internal", "service rce-1, Replicated"]


async def test_network_of_a_group_is_made_once(manager: Manager, api: Api) -> None:
    group = Network("rce-group", "10.128.0.0/24")
    await manager.create_service("rce-1", {}, {}, group)
    await manager.create_service("rce-2", {}, {}, group)
    assert api.created == ["network rce-group, internal", "service rce-1, Replicated", "service rce-2, Replicated"]


async def test_refused_service_has_the_reason_of_docker(manager: Manager, api: Api) -> None:
    reason = "invalid mount config"
    api.refusal = APIError(reason, SimpleNamespace(status_code=400, url="", reason=reason), reason)
    with pytest.raises(StartFailed, match="ann/map did not start: invalid mount config"):
        await manager.create_service("rce-1", {}, {"rce.environment": "ann/map"}, Network("rce-1"))


async def test_service_that_is_gone_is_removed(manager: Manager) -> None:
    await manager.remove_service("rce-1")


async def test_node_of_a_task_is_returned_when_it_runs(manager: Manager, api: Api) -> None:
    api.tasks_of = [[], [task("pending")], [task("preparing", "n1")], [task("running", "n1")]]
    assert await manager.wait_until_running("ann/map", "rce-1") == "n1"


async def test_end_of_a_service_waits_for_its_nodes(manager: Manager, api: Api) -> None:
    """A task that is not placed yet may still come to one of them; tasks on lost nodes do not count."""
    lost = task("running", "lost")
    api.tasks_of = [[lost, task("running", "n1")], [lost, task("pending")], [lost], [task("running", "n1")]]
    await manager.wait_until_ended("rce-1", ["n1"])
    assert api.tasks_of == [[task("running", "n1")]]


async def test_failure_on_a_node_is_explained(manager: Manager, api: Api) -> None:
    api.tasks_of = [[task("failed", "n1", Err="no space"), task("rejected", "n2", Message="no image")]]
    assert await manager.failure("rce-1", "n1") == "no space"
    assert await manager.failure("rce-1", "n2") == "no image"
    assert await manager.failure("rce-1", "n3") == "Swarm has not placed a task there"


# --- networks ---------------------------------------------------------------------------------------------------------


async def test_network_with_a_member_is_kept(manager: Manager, api: Api) -> None:
    api.present, api.found = ["rce-group"], [service("rce-1", group="rce-group")]
    await manager.remove_unused_network("rce-group")
    assert await manager.networks() == ["rce-group"]
    api.found = []
    await manager.remove_unused_network("rce-group")
    assert await manager.networks() == []


async def test_network_that_stays_in_use_times_out(manager: Manager, api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "NETWORK_TRIES", 3)
    api.present, api.refusal = ["rce-1"], APIError("has active endpoints")
    with pytest.raises(TimedOut, match="rce-1"):
        await manager.remove_network("rce-1")


# --- images and agents ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("labels", "image"),
    [({"rce.version": __version__}, "sha256:1"), ({"rce.version": "0.0.1"}, None), ({}, None), (None, None)],
)
async def test_only_images_for_this_version_are_used(
    manager: Manager, api: Api, labels: dict[str, str] | None, image: str | None
) -> None:
    api.image = labels
    assert await manager.image_id("rce/base:1") == image


async def test_export_to_a_full_disk_is_unavailable(manager: Manager, tmp_path: Path) -> None:
    with pytest.raises(Unavailable, match="cannot be exported from Docker for other nodes: No space left"):
        await manager.export("sha256:1", tmp_path)


async def test_service_of_the_agents_is_made_and_then_updated(manager: Manager, api: Api) -> None:
    await manager.update_agent_service("rce-agent", {"one": 1})
    assert api.created == ["service rce-agent, Global"]
    api.service_labels = AGENTS
    await manager.update_agent_service("rce-agent", {"two": 2})
    assert api.updated == [{"two": 2}]


async def test_agents_of_another_task_set_are_not_changed(manager: Manager, api: Api) -> None:
    api.service_labels = {**AGENTS, "rce.platform": "other"}
    with pytest.raises(InvalidRequest, match="of another task set"):
        await manager.update_agent_service("rce-agent", {})
    assert api.updated == []


# --- answers ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("state", "error", "outcome"),
    [
        ("running", "", "node"),
        ("preparing", "", None),
        ("pending", "", None),
        ("complete", "", "node"),
        ("failed", "task: non-zero exit (3)", "node"),  # it ran, and has ended since
        ("failed", "starting container failed: no such file", StartFailed),
        ("rejected", "No such image: x", StartFailed),
        ("pending", "no suitable node (insufficient resources on 2 nodes)", NoCapacity),
    ],
)
def test_outcome_of_a_task(state: str, error: str, outcome: Any) -> None:
    task = {"NodeID": "node", "Status": {"State": state, "Err": error}}
    if isinstance(outcome, type):
        with pytest.raises(outcome, match="ann/map"):
            _node_of_started("ann/map", task)
    else:
        assert _node_of_started("ann/map", task) == outcome


def node(state: str = "ready", availability: str = "active", **labels: str) -> Node:
    generic = [
        {"NamedResourceSpec": {"Kind": "NVIDIA-GPU", "Value": "a"}},
        {"DiscreteResourceSpec": {"Kind": "NVIDIA-GPU", "Value": 2}},
        {"DiscreteResourceSpec": {"Kind": "other", "Value": 9}},
    ]
    resources = {"NanoCPUs": 4_000_000_000, "MemoryBytes": 1000, "GenericResources": generic}
    return _node(
        {
            "ID": "id",
            "Status": {"State": state},
            "Spec": {"Availability": availability, "Labels": labels},
            "Description": {"Hostname": "name", "Resources": resources},
        }
    )


def test_node_resources_are_read() -> None:
    seen = node(**{"rce.feature.camera": "true", "other": "true"})
    assert (seen.features, seen.gpus, seen.size.cores, seen.size.memory) == (frozenset({"camera"}), 3, 4.0, 1000)
    assert seen.usable
    assert node(availability="pause").usable


def test_reason_of_an_unusable_node() -> None:
    assert (node("down").usable, node("down").unusable_reason) == (False, "node name is down")
    assert (node(availability="drain").usable, node(availability="drain").unusable_reason) == (
        False,
        "node name is drained",
    )
