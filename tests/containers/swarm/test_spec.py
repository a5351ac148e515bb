"""Specifications of services, without a swarm."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.docker.api import DOCKER_SOCKET
from containers.swarm.engine import SwarmEngine
from containers.swarm.spec import AgentService, Names, agent_socket, agent_task, check, spec_label, task_variables
from rce.control.calls.environments import EnvironmentSpec, Group
from rce.errors import InvalidRequest
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


def test_socket_of_an_environment_is_where_the_task_set_says() -> None:
    assert SwarmEngine.sockets.replace("{run}", RUN) == str(Names.of(LABELS, "ann/map", RUN).paths.socket)


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


def test_socket_volumes_differ_by_user_and_task_set() -> None:
    ann = Names.of(LABELS, "ann/map", RUN)
    assert ann.sockets == Names.of(LABELS, "ann/plan", "2" * 32).sockets
    assert ann.sockets != Names.of(LABELS, "bob/map", RUN).sockets
    assert ann.sockets != Names.of({**LABELS, "rce.directory": "/other"}, "ann/map", RUN).sockets


def test_agents_have_limits() -> None:
    task = agent_task(AgentService("rce/agent:1"), "rce/agent:1", {}, LABELS, "/var/lib/docker", None)
    assert task["Resources"]["Limits"].keys() == {"MemoryBytes", "Pids"}


@pytest.mark.parametrize(
    ("host", "nodes", "socket"),
    [
        ("unix:///run/user/1000/docker.sock", 1, "/run/user/1000/docker.sock"),
        ("unix:///run/user/1000/docker.sock", 2, DOCKER_SOCKET),
        ("tcp://10.0.0.1:2376", 1, DOCKER_SOCKET),
    ],
)
def test_agents_use_the_socket_of_the_manager_where_it_is_the_only_node(host: str, nodes: int, socket: str) -> None:
    path = agent_socket(host, nodes)
    task = agent_task(AgentService("rce/agent:1"), "rce/agent:1", {}, LABELS, "/var/lib/docker", None, path)
    (mount,) = [each for each in task["ContainerSpec"]["Mounts"] if each["Target"] == DOCKER_SOCKET]
    assert mount["Source"] == path == socket
