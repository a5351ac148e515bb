"""Pods of environments: pure functions from a specification to an object of Kubernetes' API."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from containers.endpoint import CONTROL, HOME, HOME_SIZE, TEMPORARY_SIZE, environment_user, variables
from containers.kubernetes.objects import CONTAINER, FEATURE, GPU, SPEC, Object, environment_labels, namespace_of
from containers.kubernetes.places import PACKAGES, SOCKETS, Places, endpoint_paths
from containers.kubernetes.seccomp import PROFILE
from containers.kubernetes.setup import ClusterSetup
from containers.limits import Limits
from containers.packages import package_directories, package_path
from rce.control.calls.environments import EnvironmentSpec
from rce.protocol.messages import ContainerData
from rce.protocol.slots import MB

STOP_TIMEOUT = 12  # seconds; the endpoint stops its nodes in less time
LONGEST_HOSTNAME = 63
NO_NAMESERVER = "127.0.0.1"  # nothing answers there
LOGS = 128 * MB  # of the files of its output, which kubelet rotates; beyond that kubelet evicts the pod
# Kubernetes reserves what a limit grants unless something else is requested. As in a swarm, only what a user requests
# explicitly is reserved; slots are counted by the task set.
LEAST_CPU, LEAST_MEMORY = "10m", 64 * MB


class PodSetup(Struct, frozen=True):
    """Settings of the pods of all environments of a task set; `command` is that of the endpoint."""

    task_set: str
    cluster: ClusterSetup
    command: Sequence[str]
    settings: Mapping[str, str]
    read_only: Sequence[str] = ()

    @property
    def places(self) -> Places:
        """Directories on the nodes."""
        return Places.of(self.cluster.directory, self.task_set)


def pod_name(run: str) -> str:
    """Return the name of the pod of a run."""
    return f"rce-{run}"


def annotated(spec: EnvironmentSpec) -> str:
    """Return the annotation with what engine and agent must know, without secrets and free text of users."""
    given = spec.options
    options = ContainerData(size=given.size, disk=given.disk, bandwidth=given.bandwidth, io=given.io, pids=given.pids)
    return msgspec.json.encode(replace(spec, token="", options=options)).decode()


def environment_pod(
    setup: PodSetup, spec: EnvironmentSpec, granted: Limits, image: str, features: Collection[str]
) -> Object:
    """Return the pod of one run of an environment.

    Kubernetes places it but never restarts it: a restarted environment is a new run with a new token, so a new pod.

    Args:
        setup: What all pods have in common.
        spec: The environment.
        granted: Its limits.
        image: Its image.
        features: Special features that its node must have by a label.
    """
    cluster, user = setup.cluster, environment_user(spec.name)
    namespace = namespace_of(cluster.namespace, spec.name, per_user=cluster.per_user)
    volumes = _volumes(setup, spec, granted)
    pod: Object = {
        "apiVersion": "v1",
        "kind": "Pod",
        "metadata": {
            "name": pod_name(spec.run),
            "namespace": namespace,
            "labels": environment_labels(setup.task_set, spec),
            "annotations": {SPEC: annotated(spec)},
        },
        "spec": {
            "restartPolicy": "Never",
            "terminationGracePeriodSeconds": STOP_TIMEOUT,
            "automountServiceAccountToken": False,
            "enableServiceLinks": False,
            "securityContext": {
                "runAsUser": user,
                "runAsGroup": user,
                "runAsNonRoot": True,
                "seccompProfile": {"type": "Localhost", "localhostProfile": PROFILE},
            },
            "nodeSelector": {f"{FEATURE}{feature}": "true" for feature in sorted(features)},
            "dnsPolicy": "None",
            "dnsConfig": {"nameservers": [NO_NAMESERVER] if spec.egress == "none" else list(cluster.nameservers)},
            "imagePullSecrets": [{"name": name} for name in cluster.pull_secrets],
            "volumes": [volume for volume, _ in volumes],
            "containers": [
                {
                    "name": CONTAINER,
                    "image": image,
                    "imagePullPolicy": "IfNotPresent",
                    "args": [_literal(word) for word in setup.command],
                    "env": _environment(setup, spec),
                    "resources": _resources(spec, granted),
                    "volumeMounts": [mount for _, mount in volumes],
                    "securityContext": {
                        "privileged": False,
                        "allowPrivilegeEscalation": False,
                        "readOnlyRootFilesystem": True,
                        "capabilities": {"drop": ["ALL"]},
                    },
                }
            ],
        },
    }
    if cluster.priority_class:
        pod["spec"]["priorityClassName"] = cluster.priority_class
    if spec.group is not None:
        pod["spec"]["hostname"] = spec.name.partition("/")[2].replace("_", "-").lower()[:LONGEST_HOSTNAME]
    return pod


def _environment(setup: PodSetup, spec: EnvironmentSpec) -> list[Object]:
    packages = package_path(package_directories(Path(PACKAGES), spec.packages), setup.settings)
    values = variables(spec, endpoint_paths(spec.run), "", {**setup.settings, **packages})
    values.pop("RCE_HOST")
    return [
        *({"name": key, "value": _literal(value)} for key, value in values.items()),
        {"name": "RCE_HOST", "valueFrom": {"fieldRef": {"fieldPath": "spec.nodeName"}}},
    ]


def _literal(value: str) -> str:
    """Escape a value, in which kubelet expands `$(NAME)`."""
    return value.replace("$(", "$$(")


def _resources(spec: EnvironmentSpec, granted: Limits) -> Object:
    given = spec.options
    limits: Object = {
        "cpu": f"{max(1, round(granted.cpu * 1000))}m",
        "memory": str(granted.memory),
        "ephemeral-storage": str(LOGS),
    }
    if given.gpus:
        limits[GPU] = str(given.gpus)
    least_cpu = f"{max(1, round(given.cpu * 1000))}m" if given.cpu else LEAST_CPU
    least_memory = int(given.memory) or min(LEAST_MEMORY, granted.memory)
    return {
        "limits": limits,
        "requests": {"cpu": least_cpu, "memory": str(least_memory), "ephemeral-storage": "1Mi"},
    }


def _volumes(setup: PodSetup, spec: EnvironmentSpec, granted: Limits) -> list[tuple[Object, Object]]:
    """Return the volumes of a pod, each with its mount."""
    places = setup.places
    volumes = [
        _of_the_node("control", places.control(spec.run), CONTROL),
        _of_the_node("links", places.sockets(spec.name), SOCKETS),
        _in_memory("home", HOME, HOME_SIZE),
        _in_memory("temporary", "/tmp", TEMPORARY_SIZE),
        _in_memory("shared-memory", "/dev/shm", granted.memory),
    ]
    if spec.packages:
        volumes.append(_of_the_node("packages", places.packages(spec.run), PACKAGES))
    if spec.group is not None:
        volumes.append(_of_the_node("hosts", places.hosts(spec.run), "/etc/hosts", "FileOrCreate"))
    volumes += [
        _of_the_node(f"given-{number}", Path(path), path, "Directory") for number, path in enumerate(setup.read_only)
    ]
    return volumes


def _of_the_node(name: str, path: Path, target: str, kind: str = "DirectoryOrCreate") -> tuple[Object, Object]:
    """Return a volume with a path of the node, which the pod can only read."""
    volume = {"name": name, "hostPath": {"path": str(path), "type": kind}}
    return volume, {"name": name, "mountPath": target, "readOnly": True}


def _in_memory(name: str, target: str, size: int) -> tuple[Object, Object]:
    volume = {"name": name, "emptyDir": {"medium": "Memory", "sizeLimit": str(size)}}
    return volume, {"name": name, "mountPath": target}
