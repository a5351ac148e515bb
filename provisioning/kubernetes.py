"""Manifests of a platform on Kubernetes: Master, its database, Robot endpoint and task set. Standard library only.

`provisioning/provision kubernetes` prints them with the given values, for `kubectl apply`. The Helm chart in
`provisioning/helm` is made of the same objects, with references to its values in their place. Every value is either a
whole field or part of a string, so that the chart needs no logic.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import secrets
import sys
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from provisioning.steps import ROOT, ProvisioningError, add_command

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from provisioning.steps import Commands

Object = dict[str, Any]
CHART = Path(__file__).with_name("helm")
VERSION: str = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
SERVER = "rce/server"
HTTP, CONTROL, AGENTS, ROBOTS, DATA, DATABASE = 9000, 8080, 8082, 9010, 9020, 5432
USER = 10000  # of the images
DATABASE_USER = 70  # of PostgreSQL in its image on Alpine
NEEDED = ("databasePassword", "robotToken", "containerToken")  # secrets that are made if they are not given


@dataclass(frozen=True, kw_only=True)
class Values:
    """Settings of a platform; the names and defaults are those of the chart's values."""

    namespace: str = "rce"
    serverImage: str = f"{SERVER}:{VERSION}"
    environmentImage: str = f"rce/mapping:{VERSION}"
    agentImage: str = f"rce/agent:{VERSION}"
    databaseImage: str = "postgres:16-alpine"
    pullSecret: str = "rce-registry"
    databasePassword: str = ""
    robotToken: str = ""
    containerToken: str = ""
    publicUrl: str = ""
    slots: str = "100"
    features: str = ""
    priorityClass: str = ""
    namespacePerUser: str = "false"
    nodeDirectory: str = "/var/lib/rce"
    seccompDirectory: str = "/var/lib/kubelet/seccomp"
    serviceType: str = "ClusterIP"
    storage: str = "10Gi"


def manifests(values: Values) -> list[Object]:
    """Return the objects of a platform, in the order in which they are to be created."""
    return [
        _object("v1", "Namespace", "", values.namespace, labels=_privileged()),
        _object("v1", "ServiceAccount", values.namespace, "rce-tasks"),
        *_rights(values),
        _secret(values),
        *(_claim(values, name) for name in ("database", "master", "robot", "tasks")),
        _service(values, "database", {"sql": DATABASE}),
        _service(values, "master", {"http": HTTP, "control": CONTROL}, values.serviceType),
        _service(values, "robot", {"ws": ROBOTS, "data": DATA}, values.serviceType),
        _service(values, "tasks", {"agents": AGENTS}),
        _database(values),
        _master(values),
        _robot(values),
        _tasks(values),
    ]


def _privileged() -> dict[str, str]:
    """Return the label with which Pod Security Admission admits the agents."""
    return {"pod-security.kubernetes.io/enforce": "privileged"}


def _rights(values: Values) -> list[Object]:
    """Return the rights of the task set: its namespace, and to look at nodes; with one a user, all namespaces."""
    change = ["get", "list", "watch", "create", "patch", "delete"]
    own = [
        _rule("", ["pods", "secrets"], change),
        _rule("", ["pods/log"], ["get"]),
        _rule("apps", ["daemonsets"], change),
        _rule("networking.k8s.io", ["networkpolicies"], change),
    ]
    nodes = [_rule("", ["nodes"], ["get", "list", "watch"])]
    return [
        {**_object("rbac.authorization.k8s.io/v1", "Role", values.namespace, "rce-tasks"), "rules": own},
        _binding(values, "Role", "rce-tasks"),
        {**_object("rbac.authorization.k8s.io/v1", "ClusterRole", "", f"{values.namespace}-nodes"), "rules": nodes},
        _binding(values, "ClusterRole", f"{values.namespace}-nodes"),
    ]


def rights_per_user(values: Values) -> list[Object]:
    """Return the further rights that a namespace for each user needs, which reach into the whole cluster."""
    name = f"{values.namespace}-users"
    change = ["get", "list", "watch", "create", "patch", "delete"]
    rules = [
        _rule("", ["namespaces"], ["get", "create", "patch"]),
        _rule("", ["pods"], change),
        _rule("", ["pods/log"], ["get"]),
        _rule("", ["secrets"], ["create", "patch"]),
        _rule("networking.k8s.io", ["networkpolicies"], ["create", "patch"]),
    ]
    role = {**_object("rbac.authorization.k8s.io/v1", "ClusterRole", "", name), "rules": rules}
    return [role, _binding(values, "ClusterRole", name)]


def _rule(group: str, resources: list[str], verbs: list[str]) -> Object:
    return {"apiGroups": [group], "resources": resources, "verbs": verbs}


def _binding(values: Values, kind: str, name: str) -> Object:
    namespace = values.namespace if kind == "Role" else ""
    return {
        **_object("rbac.authorization.k8s.io/v1", f"{kind}Binding", namespace, name),
        "roleRef": {"apiGroup": "rbac.authorization.k8s.io", "kind": kind, "name": name},
        "subjects": [{"kind": "ServiceAccount", "name": "rce-tasks", "namespace": values.namespace}],
    }


def _secret(values: Values) -> Object:
    return {
        **_object("v1", "Secret", values.namespace, "rce"),
        "stringData": {
            "databasePassword": values.databasePassword,
            "robotToken": values.robotToken,
            "containerToken": values.containerToken,
        },
    }


def _claim(values: Values, name: str) -> Object:
    """Return the claim of a volume that outlives the pods of a program."""
    return {
        **_object("v1", "PersistentVolumeClaim", values.namespace, f"rce-{name}"),
        "spec": {"accessModes": ["ReadWriteOnce"], "resources": {"requests": {"storage": values.storage}}},
    }


def _service(values: Values, name: str, ports: Mapping[str, int], kind: str = "ClusterIP") -> Object:
    return {
        **_object("v1", "Service", values.namespace, f"rce-{name}"),
        "spec": {
            "type": kind,
            "selector": {"app.kubernetes.io/name": f"rce-{name}"},
            "ports": [{"name": each, "port": port, "targetPort": port} for each, port in ports.items()],
        },
    }


def _database(values: Values) -> Object:
    settings = [
        {"name": "POSTGRES_USER", "value": "rce"},
        {"name": "POSTGRES_DB", "value": "rce"},
        {"name": "PGDATA", "value": "/data/postgresql"},
        _from_secret("POSTGRES_PASSWORD", "databasePassword"),
    ]
    return _deployment(values, "database", values.databaseImage, [], settings, DATABASE_USER, DATABASE)


def _master(values: Values) -> Object:
    settings = [
        _from_secret("DATABASE_PASSWORD", "databasePassword"),
        _from_secret("ROBOT_TOKEN", "robotToken"),
        _from_secret("CONTAINER_TOKEN", "containerToken"),
        {"name": "RCE_DATABASE", "value": f"postgresql+psycopg://rce:$(DATABASE_PASSWORD)@rce-database:{DATABASE}/rce"},
        {"name": "RCE_TOKENS", "value": "robot:robot-1:$(ROBOT_TOKEN),container:tasks-1:$(CONTAINER_TOKEN)"},
    ]
    words = ["python3", "-P", "-m", "master", "--data-dir=/data", f"--http=tcp:{HTTP}", f"--control=tcp:{CONTROL}"]
    return _deployment(values, "master", values.serverImage, words, settings, USER, HTTP)


def _robot(values: Values) -> Object:
    settings = [_from_secret("RCE_TOKEN", "robotToken"), {"name": "RCE_PUBLIC_URL", "value": values.publicUrl}]
    words = [
        "python3",
        "-P",
        "-m",
        "endpoints.robot",
        "--data-dir=/data",
        "--name=robot-1",
        f"--master=tcp:rce-master:{CONTROL}",
    ]
    words += ["--ws-host=0.0.0.0", f"--ws-port={ROBOTS}", "--data-host=0.0.0.0", f"--data-port={DATA}"]
    words += ["--data-address=rce-robot"]
    return _deployment(values, "robot", values.serverImage, words, settings, USER, ROBOTS)


def _tasks(values: Values) -> Object:
    given = {
        "RCE_SIZE": values.slots,
        "RCE_FEATURES": values.features,
        "RCE_IMAGE": values.environmentImage,
        "RCE_AGENT_IMAGE": values.agentImage,
        "RCE_NAMESPACE": values.namespace,
        "RCE_NAMESPACE_PER_USER": values.namespacePerUser,
        "RCE_PULL_SECRETS": values.pullSecret,
        "RCE_PRIORITY_CLASS": values.priorityClass,
        "RCE_NODE_DIRECTORY": values.nodeDirectory,
        "RCE_SECCOMP_DIRECTORY": values.seccompDirectory,
    }
    settings = [
        _from_secret("RCE_TOKEN", "containerToken"),
        *({"name": name, "value": value} for name, value in given.items()),
    ]
    words = ["python3", "-P", "-m", "containers", "--data-dir=/data", "--name=tasks-1", "--engine=kubernetes"]
    words += [f"--master=tcp:rce-master.{values.namespace}.svc:{CONTROL}"]
    words += [f"--agent-address=rce-tasks.{values.namespace}.svc", f"--agent-port={AGENTS}"]
    words += [f"--entry=http://rce-master.{values.namespace}.svc:{HTTP}/"]
    made = _deployment(values, "tasks", values.serverImage, words, settings, USER, AGENTS)
    pod = made["spec"]["template"]["spec"]
    pod |= {"serviceAccountName": "rce-tasks", "automountServiceAccountToken": True}
    return made


def _deployment(
    values: Values, name: str, image: str, words: Sequence[str], settings: Sequence[Object], user: int, port: int
) -> Object:
    """Return the Deployment of a program with a volume for its data; two at a time would overwrite each other's."""
    labels = {"app.kubernetes.io/name": f"rce-{name}"}
    container = {
        "name": name,
        "image": image,
        "args": list(words),
        "env": list(settings),
        "ports": [{"containerPort": port}],
        "readinessProbe": {"tcpSocket": {"port": port}},
        "resources": {"requests": {"cpu": "100m", "memory": "256Mi"}, "limits": {"memory": "2Gi"}},
        "securityContext": {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}},
        "volumeMounts": [{"name": "data", "mountPath": "/data"}, {"name": "temporary", "mountPath": "/tmp"}],
    }
    pod = {
        "automountServiceAccountToken": False,
        "enableServiceLinks": False,  # else Kubernetes sets variables named like settings of RCE
        "imagePullSecrets": [{"name": values.pullSecret}],
        "securityContext": {
            "runAsUser": user,
            "runAsGroup": user,
            "runAsNonRoot": True,
            "fsGroup": user,
            "seccompProfile": {"type": "RuntimeDefault"},
        },
        "volumes": [
            {"name": "data", "persistentVolumeClaim": {"claimName": f"rce-{name}"}},
            {"name": "temporary", "emptyDir": {}},
        ],
        "containers": [container],
    }
    return {
        **_object("apps/v1", "Deployment", values.namespace, f"rce-{name}"),
        "spec": {
            "replicas": 1,
            "strategy": {"type": "Recreate"},
            "selector": {"matchLabels": labels},
            "template": {"metadata": {"labels": labels}, "spec": pod},
        },
    }


def _from_secret(name: str, key: str) -> Object:
    return {"name": name, "valueFrom": {"secretKeyRef": {"name": "rce", "key": key}}}


def _object(version: str, kind: str, namespace: str, name: str, labels: Mapping[str, str] | None = None) -> Object:
    metadata: Object = {"name": name, "labels": {"app.kubernetes.io/part-of": "rce", **(labels or {})}}
    if namespace:
        metadata["namespace"] = namespace
    return {"apiVersion": version, "kind": kind, "metadata": metadata}


# --- the chart --------------------------------------------------------------------------------------------------------


def chart() -> dict[str, str]:
    """Return the files of the Helm chart by name. JSON is YAML, so the objects need no further library."""
    references = Values(**{field.name: f"{{{{ .Values.{field.name} }}}}" for field in fields(Values)})
    references = dataclasses.replace(references, namespace="{{ .Release.Namespace }}")
    objects = [each for each in manifests(references) if each["kind"] != "Namespace"]  # `helm --create-namespace`
    defaults = {field.name: field.default for field in fields(Values) if field.name != "namespace"}
    metadata = {
        "apiVersion": "v2",
        "name": "rce",
        "description": "A cloud platform for robots",
        "type": "application",
        "version": VERSION,
        "appVersion": VERSION,
        "kubeVersion": ">=1.20.0-0",
    }
    about = "# Made by `python -P -m provisioning.kubernetes`, of provisioning/kubernetes.py; change that.\n"
    return {
        "Chart.yaml": about + _lines(metadata),
        "values.yaml": about + _lines(defaults),
        "values.schema.json": json.dumps(_schema(), indent=2) + "\n",
        "templates/platform.yaml": about + "".join(f"---\n{json.dumps(each, indent=2)}\n" for each in objects),
    }


def _lines(entries: Mapping[str, Any]) -> str:
    return "".join(f"{key}: {json.dumps(value)}\n" for key, value in entries.items())


def _schema() -> Object:
    """Return the schema by which Helm checks the values: all are texts, and secrets are needed."""
    names = [field.name for field in fields(Values) if field.name != "namespace"]
    texts = {name: {"type": "string", **({"minLength": 1} if name in NEEDED else {})} for name in names}
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "type": "object",
        "properties": {**texts, "global": {"type": "object"}},
        "additionalProperties": False,
        "required": list(NEEDED),
    }


def write_chart(directory: Path) -> None:
    """Write the files of the chart."""
    for name, text in chart().items():
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_text(text)


# --- the command ------------------------------------------------------------------------------------------------------


def given_values(words: Sequence[str]) -> Values:
    """Return the values that the words `name=value` set; secrets that are missing are made.

    Raises:
        ProvisioningError: A word is malformed, or names no value.
    """
    names = {field.name for field in fields(Values)}
    given: dict[str, str] = {}
    for word in words:
        name, sign, value = word.partition("=")
        if not sign or name not in names:
            raise ProvisioningError(f"--set {word}: write NAME=VALUE, NAME being one of {', '.join(sorted(names))}")
        given[name] = value
    made = {name: secrets.token_hex(32) for name in NEEDED if name not in given}
    return Values(**made, **given)


def kubernetes(options: argparse.Namespace, rest: list[str]) -> int:
    """Print the manifests of a platform on Kubernetes, for `kubectl apply --filename -`."""
    values = given_values(options.set or [])
    further = rights_per_user(values) if values.namespacePerUser == "true" else []
    items = [*manifests(values), *further]
    print(json.dumps({"apiVersion": "v1", "kind": "List", "items": items}, indent=2))
    return 0


def add_commands(commands: Commands) -> None:
    """Add the command `kubernetes`."""
    command = add_command(commands, kubernetes)
    command.add_argument(
        "--set", action="append", metavar="NAME=VALUE", help="set a value of the chart (provisioning/helm/values.yaml)"
    )


if __name__ == "__main__":
    write_chart(CHART)
    sys.exit(0)
