"""Pods of environments: privileges, limits, volumes and placement, without a cluster."""

from __future__ import annotations

from typing import Any

from msgspec.structs import replace

from containers.endpoint import environment_user
from containers.kubernetes.pod import LOGS, STOP_TIMEOUT, PodSetup, environment_pod
from containers.kubernetes.seccomp import PROFILE
from containers.kubernetes.setup import AgentSetup, ClusterSetup
from containers.limits import Limits
from rce.control.calls.environments import EnvironmentSpec, Group
from rce.protocol.messages import ContainerData
from rce.protocol.slots import MB

CLUSTER = ClusterSetup(agent=AgentSetup(image="rce/agent:1", address="task-set"))
RUN = "1" * 32


def made(cluster: ClusterSetup = CLUSTER, features: tuple[str, ...] = (), **given: Any) -> Any:
    options = ContainerData(**{key: given.pop(key) for key in list(given) if key in ("cpu", "memory", "gpus", "env")})
    spec = EnvironmentSpec("ann/map", RUN, "token", options, **given)
    setup = PodSetup("0123456789abcdef", cluster, ["python3", "$(RCE_TOKEN)"], {"typesupport": "/types"}, ["/types"])
    return environment_pod(setup, spec, Limits(300 * MB, 0.5, 64), "rce/mapping:1", features)


def container(pod: Any) -> Any:
    (found,) = pod["spec"]["containers"]
    return found


def test_container_has_no_privileges() -> None:
    pod = made()
    user = environment_user("ann/map")
    assert container(pod)["securityContext"] == {
        "privileged": False,
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    assert pod["spec"]["securityContext"] == {
        "runAsUser": user,
        "runAsGroup": user,
        "runAsNonRoot": True,
        "seccompProfile": {"type": "Localhost", "localhostProfile": PROFILE},
    }
    assert not pod["spec"].keys() & {"hostNetwork", "hostPID", "hostIPC", "serviceAccountName"}
    assert pod["spec"]["automountServiceAccountToken"] is False
    assert pod["spec"]["enableServiceLinks"] is False


def test_nothing_of_the_node_can_be_written_to() -> None:
    pod = made(packages=["a" * 64])
    of_the_node = {each["name"] for each in pod["spec"]["volumes"] if "hostPath" in each}
    assert of_the_node == {"control", "links", "packages", "given-0"}
    mounts = {each["name"]: each for each in container(pod)["volumeMounts"]}
    assert all(mounts[name]["readOnly"] for name in of_the_node)
    others = [each["emptyDir"] for each in pod["spec"]["volumes"] if each["name"] not in of_the_node]
    assert all(each["medium"] == "Memory" and int(each["sizeLimit"]) > 0 for each in others)


def test_environment_sees_only_its_own_control_directory() -> None:
    paths = {each["name"]: each.get("hostPath", {}).get("path") for each in made()["spec"]["volumes"]}
    assert paths["control"] == f"/var/lib/rce/0123456789abcdef/runs/{RUN}/control"
    assert paths["links"].startswith("/var/lib/rce/0123456789abcdef/users/")


def test_limits_are_those_granted_and_requests_those_asked_for() -> None:
    assert container(made())["resources"] == {
        "limits": {"cpu": "500m", "memory": str(300 * MB), "ephemeral-storage": str(LOGS)},
        "requests": {"cpu": "10m", "memory": str(64 * MB), "ephemeral-storage": "1Mi"},
    }
    asked = container(made(cpu=0.25, memory=200 * MB, gpus=2))["resources"]
    assert asked["requests"] == {"cpu": "250m", "memory": str(200 * MB), "ephemeral-storage": "1Mi"}
    assert asked["limits"]["nvidia.com/gpu"] == "2"


def test_variables_are_not_expanded_and_the_node_is_known() -> None:
    found = container(made(env={"PRICE": "$(RCE_TOKEN)"}))
    values = {each["name"]: each for each in found["env"]}
    assert found["args"] == ["python3", "$$(RCE_TOKEN)"]
    assert "$$(RCE_TOKEN)" in values["RCE_ENV"]["value"]
    assert values["RCE_HOST"]["valueFrom"] == {"fieldRef": {"fieldPath": "spec.nodeName"}}
    assert values["RCE_SOCKET"]["value"] == f"/run/rce-user/{RUN}.sock"


def test_token_is_a_variable_and_in_no_label_or_annotation() -> None:
    pod = made()
    assert "token" in [each.get("value") for each in container(pod)["env"]]
    assert "token" not in str(pod["metadata"]).replace('"token":""', "")


def test_pod_ends_gracefully_and_is_never_restarted() -> None:
    pod = made()
    assert pod["spec"]["terminationGracePeriodSeconds"] == STOP_TIMEOUT
    assert pod["spec"]["restartPolicy"] == "Never"


def test_features_priority_and_pull_secrets_are_passed_on() -> None:
    pod = made(replace(CLUSTER, priority_class="robots", pull_secrets=["registry"]), ("camera",))["spec"]
    assert pod["nodeSelector"] == {"rce.feature/camera": "true"}
    assert (pod["priorityClassName"], pod["imagePullSecrets"]) == ("robots", [{"name": "registry"}])
    assert "priorityClassName" not in made()["spec"]


def test_only_an_environment_with_egress_has_a_nameserver() -> None:
    assert made()["spec"]["dnsConfig"] == {"nameservers": ["127.0.0.1"]}
    assert made(egress="internet")["spec"]["dnsConfig"] == {"nameservers": ["1.1.1.1", "9.9.9.9"]}


def test_member_of_a_group_has_a_hosts_file_of_its_own() -> None:
    group = Group("ann/pair", "10.128.0.0/24", "10.128.0.2", {"map": "10.128.0.2"})
    pod = made(group=group)
    (hosts,) = [each for each in container(pod)["volumeMounts"] if each["mountPath"] == "/etc/hosts"]
    assert hosts["readOnly"]
    assert pod["spec"]["hostname"] == "map"


def test_user_may_have_a_namespace_of_its_own() -> None:
    assert made()["metadata"]["namespace"] == "rce"
    assert made(replace(CLUSTER, per_user=True))["metadata"]["namespace"].startswith("rce-")
