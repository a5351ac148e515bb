"""Names and labels of what a task set creates in a cluster, and what it reads of pods and nodes.

Values of labels have at most 63 characters of a small alphabet, so names of users and environments are labels by their
hashes, and stand in annotations in full.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from typing import Any

import msgspec
from msgspec import Struct

from containers.limits import Size
from containers.process.tree import describe_end
from rce.api.egress import targets
from rce.control.calls.environments import EnvironmentSpec
from rce.protocol.slots import MB

Object = dict[str, Any]
TASK_SET, RUN, ENVIRONMENT, USER, GROUP, EGRESS = (
    "rce/task-set",
    "rce/run",
    "rce/environment",
    "rce/user",
    "rce/group",
    "rce/egress",
)
LISTED = "listed"  # value of EGRESS for a list of addresses
AGENT = "rce/agent"
SPEC = "rce/spec"  # annotation with the environment's specification, without its token
FEATURE = "rce.feature/"  # prefix of a node's labels, which have the value `true` for each special feature
GPU = "nvidia.com/gpu"  # resource of NVIDIA's device plugin
CONTAINER = "environment"  # name of the container in a pod
KILLED = 128 + 9  # exit status of a process that was killed, by the kernel or a person
_DECIMAL = {"": 1, "m": 1e-3, "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12, "P": 1e15, "u": 1e-6, "n": 1e-9}
_BINARY = {"Ki": 2**10, "Mi": 2**20, "Gi": 2**30, "Ti": 2**40, "Pi": 2**50}
_QUANTITY = re.compile(r"([0-9.]+(?:[eE][+-]?[0-9]+)?)([a-zA-Z]{0,2})")


def identity(*words: str) -> str:
    """Return 16 hex digits that stand for `words` in a label or a name."""
    return hashlib.sha256("\0".join(words).encode()).hexdigest()[:16]


def task_set_id(labels: Mapping[str, str]) -> str:
    """Return what stands for a task set; `labels` are those of its `Setup`."""
    return identity(*(f"{key}={value}" for key, value in sorted(labels.items())))


def environment_labels(task_set: str, spec: EnvironmentSpec) -> dict[str, str]:
    """Return the labels of an environment's pod."""
    labels = {
        TASK_SET: task_set,
        RUN: spec.run,
        ENVIRONMENT: identity(spec.name),
        USER: identity(spec.name.partition("/")[0]),
        EGRESS: LISTED if targets(spec.egress) else spec.egress,
    }
    return labels | ({GROUP: identity(spec.group.name)} if spec.group is not None else {})


def namespace_of(namespace: str, name: str, *, per_user: bool) -> str:
    """Return the namespace of the environment `name`: `namespace`, or that of its user."""
    user = name.partition("/")[0]
    return f"{namespace[:40]}-{identity(user)}" if per_user else namespace


def quantity(text: str | float) -> float:
    """Return the value of a quantity, such as `500m` or `2Gi`.

    Raises:
        ValueError: It is malformed.
    """
    match = _QUANTITY.fullmatch(str(text))
    if match is None or match[2] not in _DECIMAL | _BINARY:
        raise ValueError(f"{text!r} is not a quantity of Kubernetes")
    return float(match[1]) * (_DECIMAL | _BINARY)[match[2]]


class End(Struct, frozen=True):
    """End of a pod: exit status, negative for a signal, or None if it is not known, and a description."""

    status: int | None
    reason: str


class PodState(Struct, frozen=True):
    """What Kubernetes tells of the pod of an environment.

    `node` and `container` (its id in the node's runtime) are empty until they are known. `end` is None until it has
    ended, and `obstacle` is the reason why it cannot start, if there is one.
    """

    name: str
    namespace: str
    uid: str
    run: str
    node: str
    address: str
    container: str
    running: bool
    deleted: bool  # its deletion was requested
    end: End | None
    obstacle: str
    unschedulable: str
    memory: int  # its limit in bytes

    @property
    def path(self) -> str:
        """Path of its object."""
        return f"/api/v1/namespaces/{self.namespace}/pods/{self.name}"

    @property
    def never_ran(self) -> bool:
        """True if it has no process that must end."""
        return not self.node or (bool(self.obstacle) and not self.container)


class Pod(PodState, frozen=True):
    """Pod of an environment with the environment's specification, which is in its annotation."""

    spec: EnvironmentSpec


def read_pod(found: Object) -> Pod:
    """Read a pod of an environment.

    Raises:
        KeyError: It is no pod of this engine.
        msgspec.DecodeError: Its annotation is malformed, as anybody may make it who may write to the cluster.
    """
    state = msgspec.structs.asdict(read_pod_state(found))
    return Pod(**state, spec=msgspec.json.decode(found["metadata"]["annotations"][SPEC], type=EnvironmentSpec))


def read_pod_state(found: Object) -> PodState:
    """Read what Kubernetes tells of the pod of an environment; raise KeyError if it is no pod of this engine."""
    metadata, status = found["metadata"], found.get("status", {})
    states = status.get("containerStatuses") or [{}]
    state: Mapping[str, Any] = states[0].get("state", {})
    ended = state.get("terminated")
    failed = status.get("phase") in ("Failed", "Succeeded")
    memory = found["spec"]["containers"][0].get("resources", {}).get("limits", {}).get("memory", "0")
    limit = int(quantity(memory))
    end = _end(ended, limit) if ended else None
    if failed and end is None:
        end = End(None, _words(status, "it ended without a status"))
    return PodState(
        metadata["name"],
        metadata["namespace"],
        metadata["uid"],
        metadata["labels"][RUN],
        found["spec"].get("nodeName", ""),
        status.get("podIP", ""),
        states[0].get("containerID", "").rpartition("//")[2],
        "running" in state,
        "deletionTimestamp" in metadata,
        end,
        _obstacle(state, ended, found["spec"]["containers"][0].get("image", "")),
        _unschedulable(status),
        limit,
    )


def _end(ended: Mapping[str, Any], memory: int) -> End:
    code = int(ended.get("exitCode", 0))
    status = 128 - code if code > 128 else code
    reason = describe_end(status)
    if ended.get("reason") == "OOMKilled":
        reason += f"; it exceeded its memory of {memory // MB} MB"
    elif code == KILLED and memory:  # a runtime may miss that the container was out of memory
        reason += f"; it may have exceeded its memory of {memory // MB} MB"
    return End(status, reason)


def _obstacle(state: Mapping[str, Any], ended: Mapping[str, Any] | None, image: str) -> str:
    """Return why a container will not start: its image is missing, or the runtime refuses it."""
    if ended is not None:
        never_ran = ended.get("reason") in ("ContainerCannotRun", "StartError")
        return _words(ended, "the container did not start") if never_ran else ""
    waiting = state.get("waiting", {})
    reason = waiting.get("reason", "")
    if reason.startswith("Err") or "Image" in reason:
        return f"image {image}: {_words(waiting, reason)}"
    if reason == "RunContainerError":
        return _words(waiting, reason)
    return ""


def _unschedulable(status: Mapping[str, Any]) -> str:
    """Return why no node takes a pod; empty if one does or nobody knows yet."""
    for condition in status.get("conditions") or []:
        if condition.get("type") == "PodScheduled" and condition.get("reason") == "Unschedulable":
            return str(condition.get("message", "no node fits"))
    return ""


def _words(source: Mapping[str, Any], default: str) -> str:
    return ": ".join(filter(None, (source.get("reason"), source.get("message")))) or default


class Node(Struct, frozen=True):
    """A machine of the cluster; `unusable_reason` is empty while environments on it are reachable.

    A cordoned node keeps what runs there, so it is usable; `kubectl drain` deletes the pods.
    """

    name: str
    unusable_reason: str
    cordoned: bool
    features: frozenset[str]
    size: Size
    gpus: int
    address: str

    @property
    def usable(self) -> bool:
        """True if environments on it are reachable."""
        return not self.unusable_reason


def read_node(found: Object) -> Node:
    """Read a node."""
    metadata, status = found["metadata"], found.get("status", {})
    name = metadata["name"]
    conditions = {each["type"]: each["status"] for each in status.get("conditions") or []}
    reason = "" if conditions.get("Ready") == "True" else f"node {name} is not ready"
    labels: Mapping[str, str] = metadata.get("labels") or {}
    resources = status.get("allocatable") or {}
    addresses = {each["type"]: each["address"] for each in status.get("addresses") or []}
    return Node(
        name,
        reason,
        bool(found.get("spec", {}).get("unschedulable")),
        frozenset(key.removeprefix(FEATURE) for key, value in labels.items() if key.startswith(FEATURE) and value),
        Size(quantity(resources.get("cpu", "0")), int(quantity(resources.get("memory", "0")))),
        int(quantity(resources.get(GPU, "0"))),
        addresses.get("InternalIP", ""),
    )
