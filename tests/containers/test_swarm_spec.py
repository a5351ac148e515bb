"""What a swarm is told, without one."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.furnishing import hosts
from containers.swarm_manager import Node, _judge, _node
from containers.swarm_spec import Names, check, needs, surroundings
from rce.calls.environments import EnvironmentSpec, Group
from rce.errors import InvalidRequest, NoCapacity, StartFailed
from rce.messages import ContainerData

LABELS = {"rce.platform": "machine", "rce.directory": "/var/lib/rce"}
RUN = "1" * 32
NET = "10.128.0.0/24"


def values(**options: Any) -> dict[str, str]:
    spec = EnvironmentSpec("ann/map", RUN, "token", ContainerData(**options))
    return surroundings(spec, Names.of(LABELS, spec.name, spec.run), {"relay": "/run/rce/relay.sock"})


def test_what_a_user_sets_is_no_template_of_swarms() -> None:
    """As Go's templates have it: `{{"{{"}}` stands for two braces."""
    assert values(env={"X": "{{.Node.ID}}"})["RCE_ENV"] == '{"X":"{{"{{"}}.Node.ID}}"}'
    assert values()["RCE_HOST"] == "{{.Node.ID}}"


def grouped(address: str) -> EnvironmentSpec:
    members = {"map": address, "plan": "10.128.0.3"}
    return EnvironmentSpec("ann/map", RUN, "token", ContainerData(group="g"), Group("ann/g", NET, address, members))


def test_addresses_that_swarm_takes_itself_are_refused() -> None:
    check(grouped("10.128.0.127"))
    with pytest.raises(InvalidRequest, match="upper half") as raised:
        check(grouped("10.128.0.128"))
    assert raised.value.field == "containerData.groupIP"


def test_what_an_agent_must_know_has_no_secret() -> None:
    spec = replace(
        grouped("10.128.0.2"), options=ContainerData(disk=5, env={"X": "{{secret}}"}), packages=["0" * 64], egress="all"
    )
    known = msgspec.json.decode(needs(spec), type=EnvironmentSpec)
    assert known == replace(spec, token="", options=ContainerData(disk=5))
    assert "{{" not in needs(spec)


def test_names_of_members_come_before_those_of_docker() -> None:
    text = "127.0.0.1\tlocalhost\n::1\tip6-localhost\n10.128.0.200\tabc\n10.127.0.2\tabc\n"
    assert hosts(text, NET, {"plan": "10.128.0.3", "map": "10.128.0.2"}) == (
        "10.128.0.2\tmap\n10.128.0.3\tplan\n127.0.0.1\tlocalhost\n::1\tip6-localhost\n10.127.0.2\tabc\n"
    )


def test_users_and_platforms_have_sockets_of_their_own() -> None:
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
def test_what_becomes_of_a_task(state: str, error: str, outcome: Any) -> None:
    task = {"NodeID": "node", "Status": {"State": state, "Err": error}}
    if isinstance(outcome, type):
        with pytest.raises(outcome, match="ann/map"):
            _judge("ann/map", task)
    else:
        assert _judge("ann/map", task) == outcome


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


def test_what_a_node_has() -> None:
    seen = node(**{"rce.feature.camera": "true", "other": "true"})
    assert (seen.features, seen.gpus, seen.size.cores, seen.size.memory) == ({"camera"}, 3, 4.0, 1000)
    assert seen.usable
    assert node(availability="pause").usable


def test_why_a_node_is_not_used() -> None:
    assert (node("down").usable, node("down").why) == (False, "node name is down")
    assert (node(availability="drain").usable, node(availability="drain").why) == (False, "node name is drained")
