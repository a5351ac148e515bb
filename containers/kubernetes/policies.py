"""NetworkPolicy objects, which do what Docker's networks do for other engines, if the network plugin enforces them.

Isolation does not depend on them, as not every plugin enforces policies: the agent closes or filters the network of
each pod from outside (`network.py`). They add a second wall, also against other pods of the cluster.
"""

from __future__ import annotations

from containers.docker.firewall import NOT_THE_INTERNET
from containers.kubernetes.network import GROUP_PORT
from containers.kubernetes.objects import EGRESS, GROUP, LISTED, TASK_SET, Object


def policies(namespace: str, task_set: str) -> list[Object]:
    """Return the policies for the environments of a task set in a namespace."""
    internet = {"to": [{"ipBlock": {"cidr": "0.0.0.0/0", "except": list(NOT_THE_INTERNET)}}]}
    return [
        _policy(namespace, task_set, "closed", {}, []),
        _policy(namespace, task_set, "internet", {EGRESS: "internet"}, [internet]),
        _policy(namespace, task_set, "all", {EGRESS: "all"}, [{}]),
        _policy(namespace, task_set, LISTED, {EGRESS: LISTED}, [{}]),  # the agent's filter has the addresses
    ]


def group_policy(namespace: str, task_set: str, group: str) -> Object:
    """Return the policy that lets the members of a group, given by its hash, reach each other's tunnel."""
    members = {"podSelector": {"matchLabels": {TASK_SET: task_set, GROUP: group}}}
    ports = [{"protocol": "UDP", "port": GROUP_PORT}]
    policy = _policy(namespace, task_set, f"group-{group}", {GROUP: group}, [{"to": [members], "ports": ports}])
    policy["spec"]["ingress"] = [{"from": [members], "ports": ports}]
    return policy


def _policy(namespace: str, task_set: str, name: str, selected: dict[str, str], egress: list[Object]) -> Object:
    return {
        "apiVersion": "networking.k8s.io/v1",
        "kind": "NetworkPolicy",
        "metadata": {"name": f"rce-{task_set}-{name}", "namespace": namespace, "labels": {TASK_SET: task_set}},
        "spec": {
            "podSelector": {"matchLabels": {TASK_SET: task_set, **selected}},
            "policyTypes": ["Ingress", "Egress"],
            "ingress": [],
            "egress": egress,
        },
    }
