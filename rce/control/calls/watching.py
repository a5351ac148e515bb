"""Calls that observe processes and what they run: logs, ROS graph, traffic, message hops, resource usage, metrics."""

from __future__ import annotations

from typing import Literal

from msgspec import Struct

from rce.control.calls.call import Call
from rce.process.metrics import Family


class Log(Struct, frozen=True):
    """Lines of output of a node or an environment. Pass `next` as `after` to get the lines that follow."""

    lines: list[str]
    next: str = ""


class ReadLog(Call[Log], frozen=True):
    """Read the last `lines` lines of a node's output, or of the environment's own output if `node` is empty.

    With `after`, the `next` of an earlier answer, return the lines since then, possibly not all of them. With `wait`,
    answer when there are new lines, or after that many seconds. The log of a restarted node begins anew. `verbose`: the
    environment's own output with all that is internal. Raises NotFound.
    """

    node: str
    lines: int = 100
    after: str = ""
    wait: float = 0
    verbose: bool = False


class RosName(Struct, frozen=True):
    """ROS topic or service in an environment, with its types; for a topic, numbers of publishers and subscribers."""

    name: str
    types: list[str]
    publishers: int = 0
    subscribers: int = 0


class RosAction(Struct, frozen=True):
    """ROS action in an environment, with its types and the nodes that are servers and clients of it."""

    name: str
    types: list[str]
    servers: list[str] = []
    clients: list[str] = []


class RosNode(Struct, frozen=True):
    """ROS node in an environment, by its full name, with the names of its topics and services."""

    name: str
    publishes: list[str] = []
    subscribes: list[str] = []
    serves: list[str] = []


class RosGraph(Struct, frozen=True):
    """ROS topics, services, actions and nodes of an environment, sorted by name."""

    topics: list[RosName]
    services: list[RosName]
    actions: list[RosAction] = []
    nodes: list[RosNode] = []


class ReadGraph(Call[RosGraph], frozen=True):
    """Read the ROS topics, services, actions and nodes of an environment."""


class RosPackage(Struct, frozen=True):
    """ROS package that nodes of an environment can use, with its executables."""

    name: str
    executables: list[str]


class RosPackages(Struct, frozen=True):
    """ROS packages with executables, sorted by name."""

    packages: list[RosPackage]


class ReadPackages(Call[RosPackages], frozen=True):
    """Read the ROS packages of an environment that have executables."""


class Asset(Struct, frozen=True):
    """Piece of a file of a package, and the size of the whole."""

    data: bytes
    size: int


class ReadAsset(Call[Asset], frozen=True):
    """Read a piece of a file in the share directory of a package. Raises NotFound, InvalidName, LimitExceeded."""

    package: str
    path: str
    offset: int = 0


class Counts(Struct, frozen=True):
    """Messages and payload bytes since the interface, or the route between two interfaces, was created."""

    messages: int = 0
    bytes: int = 0
    drops: int = 0  # dropped messages


class InterfaceTraffic(Struct, frozen=True):
    """Traffic of an interface.

    `sent` counts a message once, however many peers it goes to; its drops are those for all peers. `peers` has, by the
    id of a peer, the messages received from it and the drops in both directions. `unheard` counts messages that were
    discarded because no node and no robot subscribes to the topic.
    """

    sent: Counts
    received: Counts
    peers: dict[str, Counts] = {}
    unheard: int = 0


class Traffic(Struct, frozen=True):
    """Traffic by interface id."""

    interfaces: dict[str, InterfaceTraffic]


class CountTraffic(Call[Traffic], frozen=True):
    """Read the traffic of all interfaces of this endpoint."""


Hop = Literal["entered", "sent", "received", "delivered"]
"""Step of a message at an endpoint: it came from the robot or from ROS; its transmission over a link began; it was
received over a link; it was handed to the robot or to ROS."""


class HopRecord(Struct, frozen=True):
    """Record of one hop of a message.

    `source` is the interface that sent the message; for the response of a service, the one that sent the request, so
    that both belong to one trace. The id `message` is unique for its source only. `time` is in seconds since 1970, by
    the clock of the machine.
    """

    source: str
    message: str
    interface: str
    hop: Hop
    time: float


class HopRecords(Struct, frozen=True):
    """Hops in the order in which they were recorded."""

    records: list[HopRecord]


class FollowMessages(Call[HopRecords], frozen=True):
    """Record the hops of all messages of these interfaces for the next `seconds`; return the hops recorded so far.

    The caller chooses the name `trace` and repeats the call.
    """

    trace: str
    interfaces: list[str]
    seconds: float = 5.0


class EnvironmentUsage(Struct, frozen=True):
    """Resource usage of an environment: processor time since its start in seconds, and present memory in bytes."""

    seconds: float
    memory: int


class Usage(Struct, frozen=True):
    """Usage by environment name; environments without figures at present are left out."""

    environments: dict[str, EnvironmentUsage]


class MeasureUsage(Call[Usage], frozen=True):
    """Measure the usage of the environments of this task set or, for an agent, of its node."""


class Metrics(Struct, frozen=True):
    """Metrics of a process."""

    families: list[Family]


class ReadMetrics(Call[Metrics], frozen=True):
    """Read the metrics of this process."""
