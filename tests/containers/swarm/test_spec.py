"""Specifications of services and the reading of Swarm's answers, without a swarm."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.swarm.manager import Node, _node, _node_of_started
from containers.swarm.resources import hosts
from containers.swarm.spec import Names, check, spec_label, task_variables
from rce.control.calls.environments import EnvironmentSpec, Group
from rce.errors import InvalidRequest, NoCapacity, StartFailed
from rce.protocol.messages import ContainerData

LABELS = {"rce.platform": "machine", "rce.directory": "/var/lib/rce"}
RUN = "1" * 32
NET = "10.128.0.0/24"


def values(**options: Any) -> dict[str, str]:
    spec = EnvironmentSpec("ann/map", RUN, "token", ContainerData(**options))
    return task_variables(spec, Names.of(LABELS, spec.name, spec.run), {"relay": "/run/rce/relay.sock"})


def test_templates_in_user_variables_are_escaped() -> None:
    """Go templates expand `{{"{{"}}` to two braces."""
    assert values(env={"X": "{{.Node.ID}}"})["RCE_ENV"] == '{"X":"{{"{{"}}.Node.ID}}"}'
    assert values()["RCE_HOST"] == "{{.Node.ID}}"


def grouped(address: str) -> EnvironmentSpec:
    members = {"map": address, "plan": "10.128.0.3"}
    return EnvironmentSpec("ann/map", RUN, "token", ContainerData(group="g"), Group("ann/g", NET, address, members))


def test_group_addresses_used_by_swarm_are_refused() -> None:
    check(grouped("10.128.0.127"))
    with pytest.raises(InvalidRequest, match="upper half") as raised:
        check(grouped("10.128.0.128"))
    assert raised.value.field == "containerData.groupIP"


def test_label_for_the_agent_has_no_secrets() -> None:
    spec = replace(
        grouped("10.128.0.2"), options=ContainerData(disk=5, env={"X": "{{secret}}"}), packages=["0" * 64], egress="all"
    )
    known = msgspec.json.decode(spec_label(spec), type=EnvironmentSpec)
    assert known == replace(spec, token="", options=ContainerData(disk=5))
    assert "{{" not in spec_label(spec)


def test_group_members_precede_other_hosts_entries() -> None:
    text = "127.0.0.1\tlocalhost\n::1\tip6-localhost\n10.128.0.200\tabc\n10.127.0.2\tabc\n"
    assert hosts(text, NET, {"plan": "10.128.0.3", "map": "10.128.0.2"}) == (
        "10.128.0.2\tmap\n10.128.0.3\tplan\n127.0.0.1\tlocalhost\n::1\tip6-localhost\n10.127.0.2\tabc\n"
    )


def test_socket_volumes_differ_by_user_and_task_set() -> None:
    ann = Names.of(LABELS, "ann/map", RUN)
    assert ann.sockets == Names.of(LABELS, "ann/plan", "2" * 32).sockets
    assert ann.sockets != Names.of(LABELS, "bob/map", RUN).sockets
    assert ann.sockets != Names.of({**LABELS, "rce.directory": "/other"}, "ann/map", RUN).sockets


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
    assert (seen.features, seen.gpus, seen.size.cores, seen.size.memory) == ({"camera"}, 3, 4.0, 1000)
    assert seen.usable
    assert node(availability="pause").usable


def test_reason_of_an_unusable_node() -> None:
    assert (node("down").usable, node("down").unusable_reason) == (False, "node name is down")
    assert (node(availability="drain").usable, node(availability="drain").unusable_reason) == (
        False,
        "node name is drained",
    )
