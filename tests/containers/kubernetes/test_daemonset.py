"""The agents' DaemonSet and Secret."""

from __future__ import annotations

import base64
from pathlib import Path

from containers.kubernetes.daemonset import agent_daemonset, agent_secret
from containers.kubernetes.setup import AgentSetup, ClusterSetup

CLUSTER = ClusterSetup(agent=AgentSetup(image="rce/agent:1", address="task-set", mounts=["/usr"]), pull_secrets=["p"])


def test_agents_run_on_every_node_without_access_to_the_api() -> None:
    made = agent_daemonset(CLUSTER, "t", {"RCE_MASTER": "tcp:master:8080"}, None)
    pod = made["spec"]["template"]["spec"]
    assert pod["tolerations"] == [{"operator": "Exists"}]
    assert pod["automountServiceAccountToken"] is False
    assert (pod["hostNetwork"], pod["hostPID"]) == (True, True)
    assert pod["imagePullSecrets"] == [{"name": "p"}]
    assert made["spec"]["selector"]["matchLabels"] == made["spec"]["template"]["metadata"]["labels"]


def test_secret_is_not_in_the_daemonset() -> None:
    secret = agent_secret(CLUSTER, "t", "hidden")
    assert base64.b64decode(secret["data"]["token"]) == b"hidden"
    made = agent_daemonset(CLUSTER, "t", {}, None)
    (container,) = made["spec"]["template"]["spec"]["containers"]
    values = {each["name"]: each for each in container["env"]}
    reference = {"secretKeyRef": {"name": secret["metadata"]["name"], "key": "token"}}
    assert values["RCE_TOKEN"]["valueFrom"] == reference


def test_certificates_and_mounts_are_read_only() -> None:
    made = agent_daemonset(CLUSTER, "t", {}, Path("/etc/rce/tls"))
    (container,) = made["spec"]["template"]["spec"]["containers"]
    mounts = {each["mountPath"]: each.get("readOnly", False) for each in container["volumeMounts"]}
    assert mounts["/etc/rce/tls"]
    assert mounts["/usr"]
    assert not mounts["/var/lib/rce/t"]
    assert {"name": "RCE_TLS", "value": "/etc/rce/tls"} in container["env"]
