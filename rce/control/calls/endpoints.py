"""Calls between the Master and endpoints about interfaces, links, routes, nodes and parameters."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rce.control.calls.call import BatchResult, Call, Nothing
from rce.errors import ErrorInfo
from rce.protocol.messages import Delivery, ParameterValue, Qos

MAX_TEXT = 1000  # characters
ShortText = Annotated[str, Meta(max_length=MAX_TEXT)]  # in reports of environments, which others store and forward


class InterfaceSpec(Struct, frozen=True):
    """Interface of an endpoint.

    `id` (32 hex digits) identifies it in data frames; `owner` is its robot or environment, as `userID/tag`.
    """

    id: str
    owner: str
    tag: str
    kind: str  # e.g. PublisherConverter
    type: str  # className, as spelled in addInterfaces
    addr: str = ""
    qos: Qos = Qos()
    format: str = "png"
    delivery: Delivery = Delivery()
    codec: str = ""


class Route(Struct, frozen=True):
    """Route: `interface` of this endpoint exchanges messages with the remote interface `peer` over `link`."""

    interface: str
    peer: str
    link: str
    name: str = ""  # of the interface for its user, `endpoint/interface`


class LinkSpec(Struct, frozen=True):
    """Data link to another endpoint, `sender`.

    The side with `dial` connects to the first of these addresses that answers.
    """

    name: str
    key: str  # 32 hex digits, known to both ends, valid for opening the link once
    dial: list[str] = []  # unix:/PATH, tcp:HOST:PORT, relay:HOST:PORT/user/tag; empty: the other side dials
    rate: int = 0  # bytes per second received from `sender` over all links together; 0 for no limit
    sender: str = ""


class NodeSpec(Struct, frozen=True):
    """ROS 2 node to run in an environment; with `launch`, a launch file of the package in place of an executable."""

    tag: str
    pkg: str
    exe: str
    args: str = ""
    name: str = ""
    namespace: str = ""
    launch: str = ""


class ParameterSpec(Struct, frozen=True):
    """ROS 2 parameter of one node of the environment, or with `node` empty of all of its nodes."""

    name: str
    value: ParameterValue
    node: str = ""

    @property
    def key(self) -> str:
        """Identifies the parameter in its environment."""
        return f"{self.node}:{self.name}"


class RecorderSpec(Struct, frozen=True):
    """Recorder of topics of an environment; without `topics`, of all. 0 is no limit of bytes or seconds of a file."""

    tag: str
    topics: list[str] = []
    max_size: int = 0
    max_duration: float = 0.0


class Sync(Call[BatchResult], frozen=True):
    """Reconcile the endpoint with its desired state: it removes objects that are not listed and creates missing ones.

    Errors are keyed by interface id, `node:TAG`, `parameter:KEY`, `recorder:TAG` and `link:NAME`.
    """

    timeout = 120.0  # nodes are stopped and started
    interfaces: list[InterfaceSpec] = []
    links: list[LinkSpec] = []
    routes: list[Route] = []
    nodes: list[NodeSpec] = []
    parameters: list[ParameterSpec] = []
    recorders: list[RecorderSpec] = []
    robots: list[str] = []  # userID/robotID of the robots with a session at this endpoint


class Bind(Call[Nothing], frozen=True):
    """Create an interface."""

    timeout = 90.0  # its type may be known to an environment that starts
    interface: InterfaceSpec


class Unbind(Call[Nothing], frozen=True):
    """Remove an interface and its routes."""

    interface: str


class OpenLink(Call[Nothing], frozen=True):
    """Open a data link, or expect the other side to open it; answered at once, not when the link is open."""

    link: LinkSpec


class CloseLink(Call[Nothing], frozen=True):
    """Close a data link."""

    link: str


class AddRoute(Call[Nothing], frozen=True):
    """Connect two interfaces; the first route of an interface starts it."""

    route: Route


class RemoveRoute(Call[Nothing], frozen=True):
    """Disconnect two interfaces; an interface without routes is stopped."""

    interface: str
    peer: str


class StartNode(Call[Nothing], frozen=True):
    """Start a node; answered when its process runs. Raises StartFailed, NotFound (package or executable)."""

    node: NodeSpec


class StopNode(Call[Nothing], frozen=True):
    """Stop a node with SIGINT, then SIGTERM, then SIGKILL; answered when its process group is gone."""

    node: str


class PutParameter(Call[Nothing], frozen=True):
    """Set a parameter for nodes started later, and at once on running nodes that declare it."""

    parameter: ParameterSpec


class Secret(Struct, frozen=True):
    """Secret of an environment's user: its value, and the variable in which nodes get it too, unless empty."""

    variable: str
    value: str = ""

    def __repr__(self) -> str:
        return f"Secret({self.variable!r})"  # values do not get into logs


class PutSecrets(Call[Nothing], frozen=True):
    """Set the secrets of an environment, by name, for nodes that start later."""

    secrets: dict[str, Secret]


class DropParameter(Call[Nothing], frozen=True):
    """Delete a parameter."""

    key: str


class StartRecorder(Call[Nothing], frozen=True):
    """Start a recorder; answered when it records. Raises NotFound (topic), LimitExceeded, DiskFull, StartFailed."""

    recorder: RecorderSpec


class StopRecorder(Call[Nothing], frozen=True):
    """Stop a recorder; answered when its last file is complete."""

    recorder: str


class RecorderEnded(Call[Nothing], frozen=True):
    """Report that a recorder of this environment ended by itself."""

    recorder: ShortText
    reason: ShortText


class NodeDied(Call[Nothing], frozen=True):
    """Report that a node of this environment ended by itself, `seconds` after its start.

    `again`: the launch file that it belongs to starts it again.
    """

    node: ShortText
    status: int
    lines: Annotated[list[ShortText], Meta(max_length=50)]
    seconds: float = 0
    again: bool = False


class Launched(Call[Nothing], frozen=True):
    """Report the nodes that run of the launch with the tag `node`."""

    node: ShortText
    nodes: Annotated[list[NodeSpec], Meta(max_length=1000)]


class LinkLost(Call[Nothing], frozen=True):
    """Report that a data link broke or did not open; the Master then gives both ends a new key."""

    link: ShortText
    reason: ShortText


class Report(Call[Nothing], frozen=True):
    """Report an error of an interface, or the number of its dropped messages, to its owner."""

    owner: ShortText
    interface: ShortText
    error: ErrorInfo | None = None
    drops: int = 0
