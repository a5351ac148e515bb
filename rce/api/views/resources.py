"""Types of the command graph: robots, environments and their contents, interfaces, connections, groups."""

from __future__ import annotations

from typing import Literal

from msgspec import Struct

from rce.api.egress import Egress
from rce.protocol.messages import ContainerData, Delivery, NodeRestart, ParameterValue, Qos


class Usage(Struct, frozen=True):
    """Current resource usage of an environment; measured only while it is watched."""

    cores: float  # average of the last seconds
    memory: int  # bytes


class Rate(Struct, frozen=True):
    """Current traffic of an interface or connection; counted only while it is watched."""

    messages: float  # per second
    bytes: float  # per second
    drops: int = 0  # since its creation
    unheard: int = 0  # since its creation: discarded, since no node and no robot subscribes to the topic


class RobotView(Struct, frozen=True):
    """Robot with a session. `away`: its socket or its Robot endpoint is lost, and it is within the grace period."""

    user: str
    robotID: str
    state: Literal["connected", "away"]
    endpoint: str  # the Robot endpoint's name
    interfaces: int
    guest: str = ""  # for a guest, the user who opened it


EnvironmentState = Literal["waiting", "starting", "ready", "away"]
"""Waiting for a machine with room, starting or restarting, ready, or temporarily without the Master."""


class EnvironmentView(Struct, frozen=True):
    """Environment and its state.

    `containerData` has the resources that it actually got, and `notEnforced` those of them that its engine does not
    enforce; `egress` is among these if programs in the environment reach more than that.
    """

    user: str
    containerTag: str
    state: EnvironmentState
    machine: str  # empty while it is waiting
    containerData: ContainerData
    address: str  # in its network group; empty without one
    egress: Egress
    packages: list[str]  # digests of its users' packages
    nodes: int
    parameters: int
    interfaces: int
    usage: Usage | None = None
    notEnforced: list[str] = []
    recorders: int = 0


class NodeEndView(Struct, frozen=True):
    """The last end of a node; `signal` is empty unless one killed it.

    `count` is the number of its ends since a user started it.
    """

    time: float
    status: int
    signal: str
    count: int
    lines: list[str]


class NodeView(Struct, frozen=True):
    """ROS 2 node of an environment. One that `waits` ended and is started again after a pause.

    With `launch` it is a launch, whose nodes have its tag as `partOf`.
    """

    user: str
    containerTag: str
    nodeTag: str
    state: Literal["starting", "running", "waiting", "ended"]
    pkg: str
    exe: str
    args: str
    name: str
    namespace: str
    restart: NodeRestart = ""
    end: NodeEndView | None = None
    launch: str = ""
    partOf: str = ""


class ParameterView(Struct, frozen=True):
    """ROS 2 parameter of an environment or, with `nodeTag`, of one of its nodes."""

    user: str
    containerTag: str
    nodeTag: str
    name: str
    value: ParameterValue


class RecorderView(Struct, frozen=True):
    """Recorder of topics of an environment, of all of them if `topics` is empty; 0 is no limit of one file."""

    user: str
    containerTag: str
    recorderTag: str
    state: Literal["starting", "recording"]
    topics: list[str]
    maxSize: int
    maxDuration: float


class RecordingView(Struct, frozen=True):
    """Recording that the platform keeps on one of its machines.

    One that is `cut off` has no end, because its environment or machine ended before: readers find all messages up to
    its last second. `containerTag` and `recorderTag` are empty for one that was uploaded; `length` is then the
    announced size, else 0.
    """

    user: str
    machine: str
    recording: str  # id on that machine
    name: str  # of the file
    state: Literal["recording", "uploading", "complete", "cut off"]
    size: int
    created: float
    containerTag: str = ""
    recorderTag: str = ""
    length: int = 0
    fingerprint: str = ""  # of an uploaded file, by which its client finds it again


class RecordingPage(Struct, frozen=True):
    """Page of recordings; those on the `missing` machines are not known at present."""

    items: list[RecordingView]
    next: str = ""
    missing: list[str] = []


class InterfaceView(Struct, frozen=True):
    """Interface of a robot or an environment."""

    user: str
    endpointTag: str  # robotID or containerTag
    interfaceTag: str
    state: Literal["starting", "ready"]
    interfaceType: str
    className: str
    addr: str
    qos: Qos
    format: str
    delivery: Delivery
    codec: str
    connections: int
    rate: Rate | None = None


class ConnectionView(Struct, frozen=True):
    """Connection of two interfaces; topic messages and service requests go from `tagA` to `tagB`."""

    user: str
    tagA: str  # endpointTag/interfaceTag
    tagB: str
    state: Literal["up", "down"]  # down: one side is offline
    className: str
    rate: Rate | None = None


class GroupView(Struct, frozen=True):
    """Network group, which exists while it has members."""

    user: str
    group: str
    subnet: str  # as 10.128.0.0/24
    members: dict[str, str]  # address by containerTag
