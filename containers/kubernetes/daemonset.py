"""The agents' DaemonSet and the Secret that they share with their task set."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path

from containers.kubernetes.objects import AGENT, TASK_SET, Object
from containers.kubernetes.places import Places
from containers.kubernetes.setup import ClusterSetup
from rce.protocol.slots import MB

AGENT_MEMORY = 1024 * MB
TOKEN = "token"  # key in the Secret


def agent_name(task_set: str) -> str:
    """Return the name of the agents' DaemonSet and of its Secret."""
    return f"rce-agent-{task_set}"


def agent_secret(cluster: ClusterSetup, task_set: str, secret: str) -> Object:
    """Return the Secret by which agents authenticate to their task set."""
    return {
        "apiVersion": "v1",
        "kind": "Secret",
        "metadata": _metadata(cluster, task_set),
        "data": {TOKEN: base64.b64encode(secret.encode()).decode()},
    }


def agent_daemonset(cluster: ClusterSetup, task_set: str, settings: Mapping[str, str], tls: Path | None) -> Object:
    """Return the DaemonSet of the agents, which run in the network and among the processes of their node.

    They are privileged, as they set up networks, limits and disks of environments from outside. They get no token for
    Kubernetes' API.

    Args:
        cluster: How the task set uses the cluster.
        task_set: What stands for it.
        settings: Further environment variables.
        tls: Directory in which each node has its own certificate, the same on all nodes.
    """
    agent, labels = cluster.agent, {TASK_SET: task_set, AGENT: "yes"}
    root = str(Places.of(cluster.directory, task_set).root)
    given = [*agent.mounts, *([str(tls)] if tls is not None else [])]
    values = {
        **settings,
        **({"RCE_TLS": str(tls)} if tls is not None else {}),
        "RCE_DATA_PORT": str(agent.data_port),
        "RCE_ENTRY": agent.entry,
        "RCE_ROOT": root,
        "RCE_SECCOMP": cluster.seccomp,
    }
    volumes = [
        _of_the_node("root", root, "DirectoryOrCreate"),
        _of_the_node("seccomp", cluster.seccomp, "DirectoryOrCreate"),
        _of_the_node("devices", "/dev"),
        _of_the_node("cgroups", "/sys/fs/cgroup"),
        *(_of_the_node(f"given-{number}", path, "Directory") for number, path in enumerate(given)),
    ]
    paths = [each["hostPath"]["path"] for each in volumes]
    read_only = {*given}
    return {
        "apiVersion": "apps/v1",
        "kind": "DaemonSet",
        "metadata": _metadata(cluster, task_set),
        "spec": {
            "selector": {"matchLabels": labels},
            "updateStrategy": {"type": "RollingUpdate"},
            "template": {
                "metadata": {"labels": labels},
                "spec": {
                    "hostNetwork": True,
                    "hostPID": True,
                    "dnsPolicy": "ClusterFirstWithHostNet",
                    "automountServiceAccountToken": False,
                    "enableServiceLinks": False,
                    "terminationGracePeriodSeconds": 5,
                    "priorityClassName": "system-node-critical",
                    "tolerations": [{"operator": "Exists"}],  # it serves until its node is gone
                    "imagePullSecrets": [{"name": name} for name in cluster.pull_secrets],
                    "volumes": [
                        *volumes,
                        {"name": "temporary", "emptyDir": {"medium": "Memory", "sizeLimit": "128Mi"}},
                    ],
                    "containers": [
                        {
                            "name": "agent",
                            "image": agent.image,
                            "imagePullPolicy": "IfNotPresent",
                            "args": list(agent.command),
                            "env": _environment(values, task_set),
                            "resources": {
                                "requests": {"cpu": "50m", "memory": "96Mi"},
                                "limits": {"memory": str(AGENT_MEMORY)},
                            },
                            "securityContext": {"privileged": True, "runAsUser": 0, "readOnlyRootFilesystem": True},
                            "volumeMounts": [
                                {"name": each["name"], "mountPath": path, "readOnly": path in read_only}
                                for each, path in zip(volumes, paths, strict=True)
                            ]
                            + [{"name": "temporary", "mountPath": "/tmp"}],
                        }
                    ],
                },
            },
        },
    }


def _environment(values: Mapping[str, str], task_set: str) -> Sequence[Object]:
    return [
        *({"name": key, "value": value.replace("$(", "$$(")} for key, value in values.items()),
        {"name": "RCE_NODE", "valueFrom": {"fieldRef": {"fieldPath": "spec.nodeName"}}},
        {"name": "RCE_ADDRESS", "valueFrom": {"fieldRef": {"fieldPath": "status.hostIP"}}},
        {"name": "RCE_TOKEN", "valueFrom": {"secretKeyRef": {"name": agent_name(task_set), "key": TOKEN}}},
    ]


def _metadata(cluster: ClusterSetup, task_set: str) -> Object:
    return {
        "name": agent_name(task_set),
        "namespace": cluster.namespace,
        "labels": {TASK_SET: task_set, "app.kubernetes.io/part-of": "rce"},
    }


def _of_the_node(name: str, path: str, kind: str = "") -> Object:
    return {"name": name, "hostPath": {"path": path, "type": kind}}
