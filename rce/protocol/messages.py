"""Messages between a robot and the platform: CC, DC, CN, CX, DM, ST, ER, as in the original RoboEarth Cloud Engine.

A text frame is `{"type": …, "data": …}`, with an optional `id` beside `type` (feature `ack`). `data` is decoded in a
second step, and the items of a list one by one, because the items of a CN are executed one after the other: if one is
malformed, those before it stay applied, and the error names it (`addNodes[2]`). Unknown keys are ignored, as in the
original.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import UNSET, Meta, Raw, Struct, UnsetType

from rce.errors import ErrorInfo, InvalidRequest
from rce.protocol.names import MAX_TAG, TAG, TYPE

CURRENT_VERSION = "20130902"
MINIMAL_VERSION = "20130415"
MAX_MSG_ID = 255
FEATURES = frozenset({"ack", "events", "resume", "parts"})

T = TypeVar("T")
Text = Annotated[str, Meta(min_length=1)]
Amount = Annotated[int, Meta(ge=0, le=2**63 - 1)]
# `rce.protocol.names` checks names where they are used, for better errors; these patterns are for the JSON Schema.
Tag = Annotated[str, Meta(extra_json_schema={"pattern": f"^{TAG.pattern}$", "maxLength": MAX_TAG})]
TagOrNone = Annotated[str, Meta(extra_json_schema={"pattern": f"^({TAG.pattern})?$", "maxLength": MAX_TAG})]
InterfaceTag = Annotated[str, Meta(extra_json_schema={"pattern": f"^{TAG.pattern}/{TAG.pattern}$"})]
TypeText = Annotated[str, Meta(extra_json_schema={"pattern": f"^{TYPE.pattern}$"})]
FrameId = Annotated[str, Meta(max_length=255)] | int


class Frame(Struct, frozen=True):
    """Text frame of any type; its `data` is not decoded yet."""

    type: str
    data: Raw
    id: FrameId | UnsetType = UNSET


# --- CC, DC -----------------------------------------------------------------------------------------------------------


class Rates(Struct, frozen=True, omit_defaults=True):
    """Limits for reading from and writing to an environment's disk, in bytes per second; 0 for no limit."""

    read: Amount = 0
    write: Amount = 0


Name = Annotated[str, Meta(min_length=1, max_length=255)]
Short = Annotated[str, Meta(max_length=255)]
VariableName = Annotated[str, Meta(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=255)]
VariableValue = Annotated[str, Meta(pattern=r"^[^\x00]*$", max_length=32_768)]


class ContainerData(Struct, frozen=True, omit_defaults=True):
    """Options of an environment (`containerData` of CC). For options that are 0 or empty, the user's defaults apply.

    `size` is in slots of a machine, `cpu` in cores, `memory` and `disk` in bytes, and `bandwidth`, which limits the
    data that the environment sends, in bytes per second.
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
    """DC: stop an environment and remove its contents."""

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
ALIASES: dict[str, InterfaceType] = {  # sent by C++ clients older than 2013
    "ServiceInterface": "ServiceClientInterface",
    "ServiceConverter": "ServiceClientConverter",
    "ServiceForwarder": "ServiceClientForwarder",
}


class Qos(Struct, frozen=True, omit_defaults=True):
    """Quality of service of an environment's topic interface, with the names of ROS 2.

    With `auto`, a setting follows the existing publishers or subscribers of the topic; without any, it is reliable or
    volatile. With `keep_all`, the sender waits and no messages are dropped.
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


Integer = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]  # the range of a ROS 2 integer parameter
ParameterValue = bool | Integer | float | str | list[bool | Integer | float | str]
ParameterName = Annotated[str, Meta(min_length=1, max_length=255, pattern=r"^[^\x00]*$")]


class SetParameter(Struct, frozen=True):
    """Set a ROS 2 parameter for nodes started later, and at once on running nodes that declare it.

    With `nodeTag` it applies to that node only.
    """

    containerTag: str
    name: ParameterName
    value: ParameterValue
    nodeTag: str = ""


class DeleteParameter(Struct, frozen=True):
    """Delete a parameter: nodes started later do not get it."""

    containerTag: str
    name: ParameterName
    nodeTag: str = ""


class ConfigureComponents(Struct, frozen=True):
    """CN: the lists are executed in this order, their items one after the other."""

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
    """Disconnect two interfaces."""

    tagA: str
    tagB: str


class ConfigureConnections(Struct, frozen=True):
    """CX: `connect` is executed before `disconnect`."""

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
"""One command. A CN or CX frame is a sequence of commands."""

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
    """DM: one message of the robot's interface `iTag`, with the value under `msg`, or the id of its blob under `msg*`.

    A robot that provides a service sends `error` in place of both to report a failure.
    """

    iTag: str
    type: str
    msgID: str
    msg: Raw | UnsetType = UNSET
    blob: Raw | UnsetType = msgspec.field(default=UNSET, name="msg*")
    error: str = ""


# --- ST, ER -----------------------------------------------------------------------------------------------------------


class InterfaceStatus(Struct, frozen=True, tag_field="topic", tag="iu"):
    """The robot's interface got its first connection, or lost its last one."""

    iTag: str
    status: bool


class Ack(Struct, frozen=True, tag_field="topic", tag="ack"):
    """The frame with the same `id` has been executed."""


class Session(Struct, frozen=True, tag_field="topic", tag="session"):
    """First ST of a connection with features: the features that the server granted and, with `resume`, the token.

    `resumed` is true if the interfaces and connections of an earlier socket still exist. `interfaces` then has the
    status of each, since status messages may have been lost when that socket broke. `grace` is the grace period of a
    session without a socket, in seconds.
    """

    features: list[str]
    token: str = ""
    grace: float = 0
    resumed: bool = False
    interfaces: dict[str, bool] = {}


class EnvironmentEvent(Struct, frozen=True, tag_field="topic", tag="environment"):
    """An environment of this user is ready (also after it was restored), failed to start, was lost, or is gone.

    With `ready` comes its address in its network group, if it is in a group.
    """

    containerTag: str
    state: Literal["ready", "failed", "lost", "gone"]
    reason: str = ""
    address: str = ""


class NodeEvent(Struct, frozen=True, tag_field="topic", tag="node"):
    """A node ended by itself: its exit status (negative for the signal that killed it) and its last lines of output."""

    containerTag: str
    nodeTag: str
    status: int
    lines: list[str] = []


class DropEvent(Struct, frozen=True, tag_field="topic", tag="drops"):
    """Number of messages of the robot's interface that were dropped since it was added, because a queue was full."""

    iTag: str
    count: int
    where: str


class LimitEvent(Struct, frozen=True, tag_field="topic", tag="limit"):
    """A limit was reached; the socket stays open unless the reason says otherwise."""

    reason: str


StatusData = InterfaceStatus | Ack | Session | EnvironmentEvent | NodeEvent | DropEvent | LimitEvent


class Status(Struct, frozen=True, tag_field="type", tag="ST", omit_defaults=True):
    """ST: a status, by the `topic` of its `data`. A robot without features gets only the topic `iu`."""

    data: StatusData
    id: FrameId | UnsetType = UNSET


class Failure(Struct, frozen=True, tag_field="type", tag="ER", omit_defaults=True):
    """ER: an error as a plain string, as in the original; robots with features also get `id` and `error`."""

    data: str
    id: FrameId | UnsetType = UNSET
    error: ErrorInfo | UnsetType = UNSET


# --- decoding ---------------------------------------------------------------------------------------------------------

_frame = msgspec.json.Decoder(Frame)
_decoders: dict[type[Any], msgspec.json.Decoder[Any]] = {}


# A string, or a token that Python's json module writes for a float but that is not JSON.
_STRING_OR_TOKEN = re.compile(rb'"(?:[^"\\]|\\.)*+"|-?Infinity|NaN')


def _quote_token(match: re.Match[bytes]) -> bytes:
    token = match[0]
    return token if token.startswith(b'"') else b'"' + token + b'"'


def decode_frame(payload: bytes) -> Frame:
    """Decode the envelope of a text frame.

    Old Python clients send the bare tokens NaN and Infinity. They are decoded as the strings "NaN" and "Infinity",
    which represent these values everywhere else.

    Raises:
        InvalidRequest: The payload is not a text frame.
    """
    try:
        return _frame.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        if b"NaN" in payload or b"Infinity" in payload:
            quoted = _STRING_OR_TOKEN.sub(_quote_token, payload)
            if quoted != payload:
                return decode_frame(quoted)
        raise InvalidRequest(f"the frame is not a JSON object with type and data: {error}") from None


def decode_as(kind: type[T], raw: Raw | bytes, where: str) -> T:
    """Decode JSON as a `kind`.

    Args:
        kind: The type of the value.
        raw: The JSON.
        where: Place of the value in its frame, for the error.

    Raises:
        InvalidRequest: The JSON is not a `kind`; the error names `where` and the path of the wrong field.
    """
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
