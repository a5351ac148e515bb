"""The command graph as it is shown: robots, environments and what is in them, interfaces, connections, groups."""

from __future__ import annotations

from typing import Literal

from msgspec import Struct

from rce.calls.environments import Egress
from rce.messages import ContainerData, ParameterValue, Qos


class Usage(Struct, frozen=True):
    """What an environment uses now; measured while somebody watches."""

    cores: float  # over the last seconds
    memory: int  # bytes


class Rate(Struct, frozen=True):
    """What passes an interface or connection now; counted while somebody watches."""

    messages: float  # a second
    bytes: float  # a second
    drops: int = 0  # since it was made


class RobotView(Struct, frozen=True):
    """A robot with a session. `away`: its socket or its Robot endpoint is lost, and its time to come back runs."""

    user: str
    robotID: str
    state: Literal["connected", "away"]
    endpoint: str  # the Robot endpoint's name
    interfaces: int
    guest: str = ""  # of whom it is a guest: the user who has opened it


EnvironmentState = Literal["waiting", "starting", "ready", "away"]
"""It waits for a machine with room; starts, also anew; is there; or has lost the Master for the moment."""


class EnvironmentView(Struct, frozen=True):
    """An environment that is wanted, and how far that has come. What it got is in `containerData`."""

    user: str
    containerTag: str
    state: EnvironmentState
    machine: str  # empty while it waits for one
    containerData: ContainerData
    address: str  # in its network group, empty without one
    egress: Egress
    packages: list[str]  # digests of users' packages
    nodes: int
    parameters: int
    interfaces: int
    usage: Usage | None = None


class NodeView(Struct, frozen=True):
    """A ROS 2 node that shall run in an environment."""

    user: str
    containerTag: str
    nodeTag: str
    state: Literal["starting", "running"]
    pkg: str
    exe: str
    args: str
    name: str
    namespace: str


class ParameterView(Struct, frozen=True):
    """A ROS 2 parameter of an environment or, with `nodeTag`, of one of its nodes."""

    user: str
    containerTag: str
    nodeTag: str
    name: str
    value: ParameterValue


class InterfaceView(Struct, frozen=True):
    """An interface of a robot or an environment."""

    user: str
    endpointTag: str  # robotID or containerTag
    interfaceTag: str
    state: Literal["starting", "ready"]
    interfaceType: str
    className: str
    addr: str
    qos: Qos
    format: str
    connections: int
    rate: Rate | None = None


class ConnectionView(Struct, frozen=True):
    """Two interfaces that shall exchange messages; topics and service requests go from `tagA` to `tagB`."""

    user: str
    tagA: str  # endpointTag/interfaceTag
    tagB: str
    state: Literal["up", "down"]  # down: one of the sides is not there
    className: str
    rate: Rate | None = None


class GroupView(Struct, frozen=True):
    """A network group: it exists while it has members."""

    user: str
    group: str
    subnet: str  # as 10.128.0.0/24
    members: dict[str, str]  # address by containerTag
