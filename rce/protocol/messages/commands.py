"""Commands of robots: the frames CC, DC, CN and CX and their items.

The items of CN and CX are decoded one by one, because they are executed one after the other: if one is malformed, those
before it stay applied, and the error names it (`addNodes[2]`).
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Raw, Struct
from msgspec.structs import replace

from rce.errors import InvalidRequest

Amount = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Name = Annotated[str, Meta(min_length=1, max_length=255)]
Short = Annotated[str, Meta(max_length=255)]
# In Python, `$` alone also matches before a newline at the end.
Address = Annotated[str, Meta(max_length=255, pattern=r"^[^\x00]*$")]
VariableName = Annotated[str, Meta(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$(?!\n)", max_length=255)]
VariableOrNone = Annotated[str, Meta(pattern=r"^([A-Za-z_][A-Za-z0-9_]*)?$(?!\n)", max_length=255)]
SecretName = Annotated[str, Meta(pattern=r"^[A-Za-z][A-Za-z0-9_]*$(?!\n)", max_length=255)]
VariableValue = Annotated[str, Meta(pattern=r"^[^\x00]*$", max_length=32_768)]
Integer = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]  # the range of a ROS 2 integer parameter
# Lists and maps may be nested and of mixed types; msgspec has no recursive types other than structs.
ParameterValue = bool | Integer | float | str | list[Any] | dict[str, Any]
MAX_DEPTH = 32  # of a parameter's lists and maps; what decodes them after this process may be deep in its stack
ParameterName = Annotated[str, Meta(min_length=1, max_length=255, pattern=r"^[^\x00]*$")]


class Rates(Struct, frozen=True, omit_defaults=True):
    """Limits for reading from and writing to an environment's disk, in bytes per second; 0 for no limit."""

    read: Amount = 0
    write: Amount = 0


class ContainerData(Struct, frozen=True, omit_defaults=True):
    """Options of an environment (`containerData` of CC). For options that are 0 or empty, the user's defaults apply.

    `size` is in slots of a machine, `cpu` in cores, `memory` and `disk` in bytes, and `bandwidth`, which limits the
    data that the environment sends, in bytes per second. `secrets` has the variable that nodes get for each of the
    user's secrets, or an empty string for a file only.
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
    secrets: Annotated[dict[SecretName, VariableOrNone], Meta(max_length=100)] = {}
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


NodeRestart = Literal["", "on-failure", "always", "no"]


class AddNode(Struct, frozen=True):
    """Start a ROS 2 node in an environment, or with `launch` the nodes of a launch file of the package.

    `restart` says when it is started again after it ended by itself; empty: after a failure, if it ran for 5 s and the
    environment has not `restart: no`. With `existOk` a node of this tag that is as described is kept, and one that is
    not is replaced.
    """

    containerTag: str
    nodeTag: str
    pkg: Name
    exe: Short = ""
    args: VariableValue = ""
    name: Short = ""
    namespace: Short = ""
    existOk: bool = False
    restart: NodeRestart = ""
    launch: Short = ""


class RemoveNode(Struct, frozen=True):
    """Stop a node."""

    containerTag: str
    nodeTag: str


InterfaceType = Literal[
    "PublisherInterface",
    "SubscriberInterface",
    "ServiceClientInterface",
    "ServiceProviderInterface",
    "ActionClientInterface",
    "ActionProviderInterface",
    "PublisherConverter",
    "SubscriberConverter",
    "ServiceClientConverter",
    "ServiceProviderConverter",
    "ActionClientConverter",
    "ActionProviderConverter",
    "PublisherForwarder",
    "SubscriberForwarder",
    "ServiceClientForwarder",
    "ServiceProviderForwarder",
    "ActionClientForwarder",
    "ActionProviderForwarder",
]
ALIASES: dict[str, InterfaceType] = {  # sent by C++ clients older than 2013
    "ServiceInterface": "ServiceClientInterface",
    "ServiceConverter": "ServiceClientConverter",
    "ServiceForwarder": "ServiceClientForwarder",
}
DEEP, SHALLOW = 1000, 10  # messages that wait by default
LARGE = {f"sensor_msgs/{name}" for name in ("Image", "CompressedImage", "PointCloud", "PointCloud2")}


def is_large(type_name: str) -> bool:
    """Return True for types of which the newest messages matter: images and point clouds."""
    return type_name.replace("/msg/", "/") in LARGE


class Qos(Struct, frozen=True, omit_defaults=True):
    """Quality of service of an environment's topic interface, with the names of ROS 2.

    With `auto`, a setting follows the existing publishers or subscribers of the topic; without any, it is reliable or
    volatile. With `keep_all`, the sender waits and no messages are dropped. With a `depth` of 0, `DEEP` messages wait,
    but only `SHALLOW` ones if they are images or point clouds, best_effort, or kept for late nodes.
    """

    reliability: Literal["auto", "reliable", "best_effort"] = "auto"
    durability: Literal["auto", "volatile", "transient_local"] = "auto"
    history: Literal["keep_last", "keep_all"] = "keep_last"
    depth: Annotated[int, Meta(ge=0, le=10_000)] = 0

    def for_type(self, type_name: str) -> Qos:
        """Return the same for messages of a type: without a depth, only the newest of large ones wait."""
        return self if self.depth or not is_large(type_name) else replace(self, depth=SHALLOW)


MAX_AGE = 7 * 24 * 3600.0  # seconds
MAX_FIELDS = 100
FieldPath = Annotated[str, Meta(pattern=r"^[A-Za-z]\w*(\.[A-Za-z]\w*)*$(?!\n)", max_length=500)]
Pixels = Annotated[int, Meta(ge=2, le=65_535)]


class Decimation(Struct, frozen=True, omit_defaults=True):
    """Fewer parts of a scan, an image or a cloud.

    Each `step`-th beam or point is sent, of images and clouds in rows each `step`-th row and column. An image is scaled
    to fit into `size`, its greatest width and height in pixels.
    """

    step: Annotated[int, Meta(ge=1, le=1000)] = 1
    size: tuple[Pixels, Pixels] | None = None


class Delivery(Struct, frozen=True, omit_defaults=True):
    """Treatment of the messages of a topic on the line between a robot and the cloud.

    Messages of a higher priority are sent first. A message that is older than `maxAge` seconds when its turn comes is
    dropped and counted. Of more than `rate` messages a second the newest are sent. A `maxAge` or `rate` of 0 is no
    limit. A robot that receives gets only some `fields` of each message, unless there are none, and decimated ones.
    """

    priority: Literal["high", "normal", "low"] = "normal"
    maxAge: Annotated[float, Meta(ge=0, le=MAX_AGE)] = 0.0
    rate: Annotated[float, Meta(ge=0, le=10_000)] = 0.0
    fields: Annotated[tuple[FieldPath, ...], Meta(max_length=MAX_FIELDS)] = ()
    decimate: Decimation = Decimation()


CodecName = Annotated[str, Meta(pattern=r"^([a-z][a-z0-9_-]{0,39})?$(?!\n)")]
Format = Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_-]{0,39}$")]
IMAGE_FORMATS = ("png", "jpeg", "json")


class AddInterface(Struct, frozen=True):
    """Add an interface to an environment (`…Interface`) or to a robot (`…Converter`, `…Forwarder`).

    The `format` of a Converter is that of images, or a converter of the Robot endpoint; that of a Forwarder is `cdr` or
    `ros1`, where `png` stands for the default. With a `codec`, the messages of a Converter are packets. `delivery` and
    `codec` are for topics of robots.
    """

    endpointTag: str
    interfaceTag: str
    interfaceType: str
    className: Short
    addr: Address = ""
    qos: Qos = Qos()
    format: Format = "png"
    delivery: Delivery = Delivery()
    codec: CodecName = ""


class RemoveInterface(Struct, frozen=True):
    """Remove an interface and its connections."""

    endpointTag: str
    interfaceTag: str


class SetParameter(Struct, frozen=True):
    """Set a ROS 2 parameter for nodes started later, and at once on running nodes that declare it.

    With `nodeTag` it applies to that node only.
    """

    containerTag: str
    name: ParameterName
    value: ParameterValue
    nodeTag: str = ""

    def __post_init__(self) -> None:
        """Check what is within a list or map.

        Raises:
            InvalidRequest: It is nested too deeply, or an integer in it does not fit into 64 bits.
        """
        if isinstance(self.value, list | dict):
            _check_items(self.value, MAX_DEPTH)


def _check_items(value: Any, depth: int) -> None:
    if isinstance(value, list | dict):
        if not depth:
            raise InvalidRequest(f"value: lists and maps are nested more than {MAX_DEPTH} deep", field="value")
        for item in value.values() if isinstance(value, dict) else value:
            _check_items(item, depth - 1)
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise InvalidRequest("value: an integer in it does not fit into 64 bits", field="value")


class DeleteParameter(Struct, frozen=True):
    """Delete a parameter: nodes started later do not get it."""

    containerTag: str
    name: ParameterName
    nodeTag: str = ""


TopicName = Annotated[str, Meta(min_length=1, max_length=255, pattern=r"^[^\x00\s]*$(?!\n)")]
Topics = Annotated[list[TopicName], Meta(max_length=100)]
Seconds = Annotated[float, Meta(ge=0, le=1e9)]


class AddRecorder(Struct, frozen=True):
    """Record topics of an environment on its machine, also in its later lives; without `topics`, all of them.

    The next file begins after `maxSize` bytes or `maxDuration` seconds; 0 is no limit. With `existOk` a recorder of
    this tag that is as described is kept, and one that is not is replaced.
    """

    containerTag: str
    recorderTag: str
    topics: Topics = []
    maxSize: Amount = 0
    maxDuration: Seconds = 0.0
    existOk: bool = False


class RemoveRecorder(Struct, frozen=True):
    """End a recorder; its recordings are kept."""

    containerTag: str
    recorderTag: str


class UseService(Struct, frozen=True):
    """Take part in a service of the catalogue: an instance is chosen or started, and its interfaces are connected.

    `service` is its name, or `user/name` for one of another user. Names are made from `containerTag`, by default the
    name of the service: that of the environment if the service is not shared, and those of the robot's interfaces,
    `containerTag_NAME`. With `raw` these are Forwarders.
    """

    service: Name
    containerTag: str = ""
    raw: bool = False


class LeaveService(Struct, frozen=True):
    """Take part in a service no longer: its interfaces are removed."""

    containerTag: str


class ConfigureComponents(Struct, frozen=True):
    """CN: the lists are executed in this order, their items one after the other."""

    addNodes: list[Raw] = []
    removeNodes: list[Raw] = []
    addInterfaces: list[Raw] = []
    removeInterfaces: list[Raw] = []
    setParam: list[Raw] = []
    deleteParam: list[Raw] = []
    addRecorders: list[Raw] = []
    removeRecorders: list[Raw] = []
    useServices: list[Raw] = []
    leaveServices: list[Raw] = []


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
    | AddRecorder
    | RemoveRecorder
    | UseService
    | LeaveService
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
    "addRecorders": AddRecorder,
    "removeRecorders": RemoveRecorder,
    "useServices": UseService,
    "leaveServices": LeaveService,
}
CX_ITEMS: dict[str, type[Command]] = {"connect": Connect, "disconnect": Disconnect}
