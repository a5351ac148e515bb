"""Names and labels of objects, and what is read of pods and nodes."""

from __future__ import annotations

import re
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from containers.kubernetes.objects import (
    GROUP,
    environment_labels,
    namespace_of,
    quantity,
    read_node,
    read_pod,
    read_pod_state,
    task_set_id,
)
from containers.kubernetes.pod import annotated
from containers.limits import Size
from rce.control.calls.environments import EnvironmentSpec, Group
from rce.protocol.messages import ContainerData
from rce.protocol.slots import MB

LABEL = re.compile(r"[A-Za-z0-9]([A-Za-z0-9_.-]{0,61}[A-Za-z0-9])?")
SPEC = EnvironmentSpec("ann@example.org/map", "1" * 32, "token", ContainerData(size=2))


def listed(status: dict[str, Any], **metadata: Any) -> dict[str, Any]:
    return {
        "metadata": {
            "name": "rce-1",
            "namespace": "rce",
            "uid": "u",
            "labels": environment_labels("task-set", SPEC),
            "annotations": {"rce/spec": annotated(SPEC)},
            **metadata,
        },
        "spec": {"nodeName": "n1", "containers": [{"resources": {"limits": {"memory": "32Mi"}}}]},
        "status": status,
    }


def pod(status: dict[str, Any], **metadata: Any) -> Any:
    return read_pod(listed(status, **metadata))


def in_state(state: dict[str, Any], phase: str = "Running") -> Any:
    return pod({"phase": phase, "containerStatuses": [{"state": state, "containerID": "containerd://c0ffee"}]})


@pytest.mark.parametrize(
    ("text", "value"), [("500m", 0.5), ("2", 2), ("2Gi", 2**31), ("1e3", 1000), ("3k", 3000), ("128974848", 128974848)]
)
def test_quantities_are_read(text: str, value: float) -> None:
    assert quantity(text) == value


@pytest.mark.parametrize("text", ["", "Gi", "1Xi", "-1"])
def test_malformed_quantity_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="quantity"):
        quantity(text)


def test_labels_are_valid_for_any_egress() -> None:
    listed = replace(SPEC, egress="10.0.0.5:5432,192.0.2.0/28:443")
    assert environment_labels("t", listed)["rce/egress"] == "listed"
    assert environment_labels("t", replace(SPEC, egress="internet"))["rce/egress"] == "internet"


def test_labels_are_valid_for_any_name() -> None:
    group = Group("ann@example.org/" + "g" * 200, "10.128.0.0/24", "10.128.0.2")
    labels = environment_labels(
        task_set_id({"a": "b"}), EnvironmentSpec("ann@example.org/" + "m" * 200, "1" * 32, "", ContainerData(), group)
    )
    assert GROUP in labels
    assert all(LABEL.fullmatch(value) for value in labels.values())


def test_namespace_of_a_user_is_the_same_for_all_environments() -> None:
    assert namespace_of("rce", "ann/map", per_user=False) == "rce"
    ann = namespace_of("rce", "ann/map", per_user=True)
    assert ann == namespace_of("rce", "ann/plan", per_user=True)
    assert ann != namespace_of("rce", "bob/map", per_user=True)
    assert re.fullmatch(r"rce-[0-9a-f]{16}", ann)


def test_running_pod_has_a_container_and_no_end() -> None:
    found = in_state({"running": {}})
    assert (found.running, found.container, found.node, found.end, found.memory) == (
        True,
        "c0ffee",
        "n1",
        None,
        32 * MB,
    )
    assert found.spec.options.size == 2
    assert found.spec.token == "", "no secret is in an annotation"


@pytest.mark.parametrize(
    ("ended", "status", "reason"),
    [
        ({"exitCode": 3, "reason": "Error"}, 3, "3"),
        ({"exitCode": 143, "reason": "Error"}, -15, "15"),
        ({"exitCode": 137, "reason": "OOMKilled"}, -9, "it exceeded its memory of 32 MB"),
        ({"exitCode": 137, "reason": "Error"}, -9, "it may have exceeded its memory of 32 MB"),
    ],
)
def test_end_has_status_and_reason(ended: dict[str, Any], status: int, reason: str) -> None:
    found = in_state({"terminated": ended}, "Failed")
    assert found.end.status == status
    assert reason in found.end.reason
    assert not found.obstacle


def test_evicted_pod_has_ended_without_a_status() -> None:
    found = pod({"phase": "Failed", "reason": "Evicted", "message": "the node was low on memory"})
    assert (found.end.status, found.end.reason) == (None, "Evicted: the node was low on memory")


@pytest.mark.parametrize(
    "state",
    [
        {"waiting": {"reason": "ErrImagePull", "message": "no such image"}},
        {"waiting": {"reason": "ImagePullBackOff", "message": "no such image"}},
        {"terminated": {"exitCode": 127, "reason": "ContainerCannotRun", "message": "no such image"}},
        {"terminated": {"exitCode": 128, "reason": "StartError", "message": "no such image"}},
    ],
)
def test_pod_that_cannot_start_has_an_obstacle(state: dict[str, Any]) -> None:
    assert in_state(state, "Pending").obstacle.endswith(": no such image")


def test_pod_that_is_being_created_has_no_obstacle() -> None:
    assert in_state({"waiting": {"reason": "ContainerCreating"}}, "Pending").obstacle == ""


def test_pod_that_no_node_takes_says_why() -> None:
    condition = {"type": "PodScheduled", "status": "False", "reason": "Unschedulable", "message": "0/1 nodes"}
    assert pod({"phase": "Pending", "conditions": [condition]}).unschedulable == "0/1 nodes"


def test_deleted_pod_is_known() -> None:
    assert pod({"phase": "Running"}, deletionTimestamp="2026-01-01T00:00:00Z").deleted


def test_node_has_size_features_and_readiness() -> None:
    found = {
        "metadata": {"name": "n1", "labels": {"rce.feature/camera": "true", "rce.feature/off": "", "other": "x"}},
        "spec": {"unschedulable": True},
        "status": {
            "conditions": [{"type": "MemoryPressure", "status": "False"}, {"type": "Ready", "status": "True"}],
            "allocatable": {"cpu": "3500m", "memory": "2Gi", "nvidia.com/gpu": "2"},
            "addresses": [{"type": "Hostname", "address": "n1"}, {"type": "InternalIP", "address": "10.0.0.1"}],
        },
    }
    node = read_node(found)
    assert (node.usable, node.cordoned, node.features, node.gpus) == (True, True, frozenset({"camera"}), 2)
    assert (node.size, node.address) == (Size(3.5, 2**31), "10.0.0.1")
    found["status"]["conditions"] = [{"type": "Ready", "status": "Unknown"}]  # type: ignore[index]
    assert read_node(found).unusable_reason == "node n1 is not ready"


@pytest.mark.parametrize("annotations", [{}, {"rce/spec": "{"}, {"rce/spec": "{}"}])
def test_state_of_a_pod_is_read_whatever_its_annotations(annotations: dict[str, str]) -> None:
    found = listed({"phase": "Running"}, annotations=annotations)
    with pytest.raises((KeyError, msgspec.DecodeError)):
        read_pod(found)
    state = read_pod_state(found)
    assert (state.path, state.run, state.node) == ("/api/v1/namespaces/rce/pods/rce-1", SPEC.run, "n1")
