"""Interfaces, links, routes, nodes and parameters: what the Master asks of endpoints, and what they report."""

from __future__ import annotations

from msgspec import Struct

from rce.calls.call import Call, Nothing, Settled
from rce.errors import ErrorInfo
from rce.messages import ParameterValue, Qos


class InterfaceSpec(Struct, frozen=True):
    """An interface as an endpoint sees it.

    `id` (32 hex) names it in data frames; `owner` is the robot or environment, as `userID/tag`.
    """

    id: str
    owner: str
    tag: str
    kind: str  # e.g. PublisherConverter
    type: str  # className, in the spelling given at addInterfaces
    addr: str = ""
    qos: Qos = Qos()
    format: str = "png"


class Route(Struct, frozen=True):
    """`interface` of this endpoint exchanges messages with the remote interface `peer` over `link`."""

    interface: str
    peer: str
    link: str


class LinkSpec(Struct, frozen=True):
    """A data link to another endpoint. The side with `dial` connects to the first address that answers."""

    name: str
    key: str  # 32 hex, known to both ends, good for one opening
    dial: list[str] = []  # unix:/PATH, tcp:HOST:PORT, relay:HOST:PORT/user/tag; empty: wait for the other side
    rate: int = 0  # bytes a second that are taken from `sender`, over all links together; 0: no limit
    sender: str = ""


class NodeSpec(Struct, frozen=True):
    """A ROS 2 node that runs in an environment."""

    tag: str
    pkg: str
    exe: str
    args: str = ""
    name: str = ""
    namespace: str = ""


class ParameterSpec(Struct, frozen=True):
    """A ROS 2 parameter: of every node of the environment, or of one node."""

    name: str
    value: ParameterValue
    node: str = ""

    @property
    def key(self) -> str:
        return f"{self.node}:{self.name}"


class Sync(Call[Settled], frozen=True):
    """All that this endpoint shall have: it removes what is not named here and makes what it lacks.

    Failures are keyed by interface id, `node:TAG`, `parameter:KEY`, `link:NAME`.
    """

    interfaces: list[InterfaceSpec] = []
    links: list[LinkSpec] = []
    routes: list[Route] = []
    nodes: list[NodeSpec] = []
    parameters: list[ParameterSpec] = []
    robots: list[str] = []  # userID/robotID of those with a session here


class Bind(Call[Nothing], frozen=True):
    """Make an interface."""

    interface: InterfaceSpec


class Unbind(Call[Nothing], frozen=True):
    """Remove an interface and its routes."""

    interface: str


class OpenLink(Call[Nothing], frozen=True):
    """Open a data link, or expect the other side to; answered when the spec is taken, not when the link is up."""

    link: LinkSpec


class CloseLink(Call[Nothing], frozen=True):
    """Close a data link."""

    link: str


class AddRoute(Call[Nothing], frozen=True):
    """Let a pair of interfaces exchange messages; the first route of an interface starts it."""

    route: Route


class RemoveRoute(Call[Nothing], frozen=True):
    """Part a pair of interfaces; losing its last route stops an interface."""

    interface: str
    peer: str


class StartNode(Call[Nothing], frozen=True):
    """Start a node; answered when the process runs. StartFailed, NotFound (package, executable)."""

    node: NodeSpec


class StopNode(Call[Nothing], frozen=True):
    """Stop a node: SIGINT, then SIGTERM, then SIGKILL; answered when its process group is gone."""

    node: str


class PutParameter(Call[Nothing], frozen=True):
    """Set a parameter for later nodes, and live where a running node declares it."""

    parameter: ParameterSpec


class DropParameter(Call[Nothing], frozen=True):
    """Forget a parameter."""

    key: str


class NodeDied(Call[Nothing], frozen=True):
    """A node of this environment ended by itself, `seconds` after its start."""

    node: str
    status: int
    lines: list[str]
    seconds: float = 0


class LinkLost(Call[Nothing], frozen=True):
    """A data link broke or did not open; the Master gives both ends a new key."""

    link: str
    reason: str


class Report(Call[Nothing], frozen=True):
    """Something that the owner of an interface should know: a failure (its message) or drops."""

    owner: str
    interface: str
    error: ErrorInfo | None = None
    drops: int = 0
