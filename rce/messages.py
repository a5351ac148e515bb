"""The messages between a robot and the platform: CC, DC, CN, CX, DM, ST, ER, as in the original RoboEarth Cloud Engine.

A text frame is `{"type": …, "data": …}`, with an optional `id` beside `type` (feature `ack`). `data` is decoded in a
second step, and the items of a list one by one, because the items of a CN run one after the other: those before a bad
one stay applied, and the error names the bad one (`addNodes[2]`). Unknown keys are ignored, as the original did.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import UNSET, Meta, Raw, Struct, UnsetType

from rce.errors import ErrorInfo, InvalidRequest
from rce.names import MAX_TAG, TAG, TYPE

CURRENT_VERSION = "20130902"
MINIMAL_VERSION = "20130415"
MAX_MSG_ID = 255
FEATURES = frozenset({"ack", "events", "resume", "parts"})

T = TypeVar("T")
Text = Annotated[str, Meta(min_length=1)]
Amount = Annotated[int, Meta(ge=0, le=2**63 - 1)]
# Names are checked where they are used, with an error of their own (rce.names); schemas have the rule from here.
Tag = Annotated[str, Meta(extra_json_schema={"pattern": f"^{TAG.pattern}$", "maxLength": MAX_TAG})]
TagOrNone = Annotated[str, Meta(extra_json_schema={"pattern": f"^({TAG.pattern})?$", "maxLength": MAX_TAG})]
InterfaceTag = Annotated[str, Meta(extra_json_schema={"pattern": f"^{TAG.pattern}/{TAG.pattern}$"})]
TypeText = Annotated[str, Meta(extra_json_schema={"pattern": f"^{TYPE.pattern}$"})]
FrameId = Annotated[str, Meta(max_length=255)] | int


class Frame(Struct, frozen=True):
    """Any text frame, its `data` still undecoded."""

    type: str
    data: Raw
    id: FrameId | UnsetType = UNSET


# --- CC, DC -----------------------------------------------------------------------------------------------------------


class Rates(Struct, frozen=True, omit_defaults=True):
    """What an environment reads from and writes to its disk at most, each in bytes a second; 0: no limit."""

    read: Amount = 0
    write: Amount = 0


Name = Annotated[str, Meta(min_length=1, max_length=255)]
Short = Annotated[str, Meta(max_length=255)]
VariableName = Annotated[str, Meta(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=255)]
VariableValue = Annotated[str, Meta(pattern=r"^[^\x00]*$", max_length=32_768)]


class ContainerData(Struct, frozen=True, omit_defaults=True):
    """Options of an environment (`containerData` of CC); what is left at 0 or empty is as its user's defaults say.

    `size` is in slots of a machine, `cpu` in cores; `memory` and `disk` are in bytes, `bandwidth` (of what the
    environment sends) in bytes a second.
    """

    image: Annotated[str, Meta(max_length=255)] = ""
    size: Annotated[int, Meta(ge=1, le=1000)] = 1
    cpu: Annotated[float, Meta(ge=0)] = 0
    memory: Amount = 0
    pids: Amount = 0
    disk: Amount = 0
    bandwidth: Amount = 0
    io: Rates = Rates()
    gpus: Annotated[int, Meta(ge=0, le=1000)] = 0
    specialFeatures: Annotated[list[Name], Meta(max_length=100)] = []
    env: Annotated[dict[VariableName, VariableValue], Meta(max_length=100)] = {}
    packages: Annotated[list[Name], Meta(max_length=100)] = []
    group: Short = ""
    groupIP: Short = ""
    groupIp: Short = ""
    restart: Literal["always", "no"] = "always"


class CreateContainer(Struct, frozen=True):
    """CC: start an environment."""

    containerTag: str
    containerData: ContainerData = ContainerData()


class DestroyContainer(Struct, frozen=True):
    """DC: stop an environment and remove all that is in it."""

    containerTag: str


# --- CN ---------------------------------------------------------------------------------------------------------------


class AddNode(Struct, frozen=True):
    """Start a ROS 2 node in an environment."""

    containerTag: str
    nodeTag: str
    pkg: Name
    exe: Name
    args: VariableValue = ""
    name: Short = ""
    namespace: Short = ""


class RemoveNode(Struct, frozen=True):
    """Stop a node."""

    containerTag: str
    nodeTag: str


InterfaceType = Literal[
    "PublisherInterface",
    "SubscriberInterface",
    "ServiceClientInterface",
    "ServiceProviderInterface",
    "PublisherConverter",
    "SubscriberConverter",
    "ServiceClientConverter",
    "ServiceProviderConverter",
    "PublisherForwarder",
    "SubscriberForwarder",
    "ServiceClientForwarder",
    "ServiceProviderForwarder",
]
ALIASES: dict[str, InterfaceType] = {  # what C++ clients from before 2013 send
    "ServiceInterface": "ServiceClientInterface",
    "ServiceConverter": "ServiceClientConverter",
    "ServiceForwarder": "ServiceClientForwarder",
}


class Qos(Struct, frozen=True, omit_defaults=True):
    """Quality of service of an environment's topic interface, by ROS 2's names.

    What is left at `auto` follows the publishers or subscribers that the topic already has, else reliable and volatile.
    `keep_all` makes the sender wait instead of dropping.
    """

    reliability: Literal["auto", "reliable", "best_effort"] = "auto"
    durability: Literal["auto", "volatile", "transient_local"] = "auto"
    history: Literal["keep_last", "keep_all"] = "keep_last"
    depth: Annotated[int, Meta(ge=1, le=10_000)] = 10


class AddInterface(Struct, frozen=True):
    """Add an interface to an environment (`…Interface`) or to a robot (`…Converter`, `…Forwarder`)."""

    endpointTag: str
    interfaceTag: str
    interfaceType: str
    className: Short
    addr: Short = ""
    qos: Qos = Qos()
    format: Literal["png", "jpeg", "json"] = "png"


class RemoveInterface(Struct, frozen=True):
    """Remove an interface and its connections."""

    endpointTag: str
    interfaceTag: str


Integer = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]  # what a ROS 2 parameter holds
ParameterValue = bool | Integer | float | str | list[bool | Integer | float | str]
ParameterName = Annotated[str, Meta(min_length=1, max_length=255, pattern=r"^[^\x00]*$")]


class SetParameter(Struct, frozen=True):
    """Set a ROS 2 parameter for nodes started from now on, and live on the running nodes that declare it.

    With `nodeTag` it concerns that node alone.
    """

    containerTag: str
    name: ParameterName
    value: ParameterValue
    nodeTag: str = ""


class DeleteParameter(Struct, frozen=True):
    """Forget a parameter: nodes started later do not get it."""

    containerTag: str
    name: ParameterName
    nodeTag: str = ""


class ConfigureComponents(Struct, frozen=True):
    """CN: its lists run in this order, their items one after the other."""

    addNodes: list[Raw] = []
    removeNodes: list[Raw] = []
    addInterfaces: list[Raw] = []
    removeInterfaces: list[Raw] = []
    setParam: list[Raw] = []
    deleteParam: list[Raw] = []


# --- CX ---------------------------------------------------------------------------------------------------------------


class Connect(Struct, frozen=True):
    """Connect two interfaces, each `endpointTag/interfaceTag`, in either order."""

    tagA: str
    tagB: str


class Disconnect(Struct, frozen=True):
    """Take a connection away."""

    tagA: str
    tagB: str


class ConfigureConnections(Struct, frozen=True):
    """CX: `connect` runs before `disconnect`."""

    connect: list[Raw] = []
    disconnect: list[Raw] = []


Command = (
    CreateContainer
    | DestroyContainer
    | AddNode
    | RemoveNode
    | AddInterface
    | RemoveInterface
    | SetParameter
    | DeleteParameter
    | Connect
    | Disconnect
)
"""One thing to do. A CN or CX is a sequence of them."""

CN_ITEMS: dict[str, type[Command]] = {
    "addNodes": AddNode,
    "removeNodes": RemoveNode,
    "addInterfaces": AddInterface,
    "removeInterfaces": RemoveInterface,
    "setParam": SetParameter,
    "deleteParam": DeleteParameter,
}
CX_ITEMS: dict[str, type[Command]] = {"connect": Connect, "disconnect": Disconnect}


# --- DM ---------------------------------------------------------------------------------------------------------------


class DataMessage(Struct, frozen=True, omit_defaults=True):
    """DM: one message of the robot's interface `iTag`; the value stands under `msg`, or its blob's id under `msg*`.

    `error` in place of both is how a robot that provides a service reports its failure.
    """

    iTag: str
    type: str
    msgID: str
    msg: Raw | UnsetType = UNSET
    blob: Raw | UnsetType = msgspec.field(default=UNSET, name="msg*")
    error: str = ""


# --- ST, ER -----------------------------------------------------------------------------------------------------------


class InterfaceStatus(Struct, frozen=True, tag_field="topic", tag="iu"):
    """The robot's interface got its first connection, or lost its last."""

    iTag: str
    status: bool


class Ack(Struct, frozen=True, tag_field="topic", tag="ack"):
    """The frame with the same `id` is carried out."""


class Session(Struct, frozen=True, tag_field="topic", tag="session"):
    """First ST of a connection with features: those that the server granted and, with `resume`, the token.

    `resumed` tells whether the interfaces and connections of an earlier socket are still there; then `interfaces` has
    the status of each, since what was said while that socket broke may not have been heard.
    """

    features: list[str]
    token: str = ""
    grace: float = 0
    resumed: bool = False
    interfaces: dict[str, bool] = {}


class EnvironmentEvent(Struct, frozen=True, tag_field="topic", tag="environment"):
    """An environment of this user is ready, failed to start, was lost, is restored, or is gone.

    With `ready` comes its address in its network group, if it is in one.
    """

    containerTag: str
    state: Literal["ready", "failed", "lost", "gone"]
    reason: str = ""
    address: str = ""


class NodeEvent(Struct, frozen=True, tag_field="topic", tag="node"):
    """A node ended by itself: its exit status (negative: the signal that ended it) and its last lines."""

    containerTag: str
    nodeTag: str
    status: int
    lines: list[str] = []


class DropEvent(Struct, frozen=True, tag_field="topic", tag="drops"):
    """Messages of the robot's interface dropped since it was added, because a queue was full."""

    iTag: str
    count: int
    where: str


class LimitEvent(Struct, frozen=True, tag_field="topic", tag="limit"):
    """A limit was hit; the socket stays open unless the reason says otherwise."""

    reason: str


StatusData = InterfaceStatus | Ack | Session | EnvironmentEvent | NodeEvent | DropEvent | LimitEvent


class Status(Struct, frozen=True, tag_field="type", tag="ST", omit_defaults=True):
    """ST: `data` by its `topic`. Without features a robot sees the topic `iu` only."""

    data: StatusData
    id: FrameId | UnsetType = UNSET


class Failure(Struct, frozen=True, tag_field="type", tag="ER", omit_defaults=True):
    """ER: a bare string, as in the original; `id` and `error` stand beside it for robots with features."""

    data: str
    id: FrameId | UnsetType = UNSET
    error: ErrorInfo | UnsetType = UNSET


# --- decoding ---------------------------------------------------------------------------------------------------------

_frame = msgspec.json.Decoder(Frame)
_decoders: dict[type[Any], msgspec.json.Decoder[Any]] = {}


# A string, or one of the tokens that Python's json writes for floats and that JSON does not have.
_not_json = re.compile(rb'"(?:[^"\\]|\\.)*+"|-?Infinity|NaN')


def _quote_token(match: re.Match[bytes]) -> bytes:
    token = match[0]
    return token if token.startswith(b'"') else b'"' + token + b'"'


def decode_frame(payload: bytes) -> Frame:
    """The envelope of a text frame; raises InvalidRequest.

    Old Python clients send the bare tokens NaN and Infinity: they come out as the strings of the same name, which stand
    for these values everywhere else.
    """
    try:
        return _frame.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        if b"NaN" in payload or b"Infinity" in payload:
            quoted = _not_json.sub(_quote_token, payload)
            if quoted != payload:
                return decode_frame(quoted)
        raise InvalidRequest(f"the frame is not a JSON object with type and data: {error}") from None


def decode_as(kind: type[T], raw: Raw | bytes, where: str) -> T:
    """`raw` as `kind`; the error names `where` and the field's path."""
    decoder = _decoders.get(kind)
    if decoder is None:
        decoder = _decoders[kind] = msgspec.json.Decoder(kind)
    try:
        value: T = decoder.decode(raw)
        return value
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        reason, _, path = str(error).partition(" - at `$")
        path = path.rstrip("`").lstrip(".")
        raise InvalidRequest(f"{where}{'.' if path else ''}{path}: {reason}", field=path) from None
