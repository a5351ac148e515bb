"""Request bodies that create resources: the items of CC, CN and CX without the parts that are in the path."""

from __future__ import annotations

from msgspec import Struct

from rce.protocol.messages import (
    CodecName,
    ContainerData,
    Delivery,
    Format,
    InterfaceType,
    NodeRestart,
    ParameterName,
    ParameterValue,
    Qos,
)
from rce.protocol.messages.commands import Address, Amount, Seconds, Topics
from rce.protocol.names import InterfaceTag, Tag, TagOrNone, Text, TypeText


class NewEnvironment(Struct, frozen=True, forbid_unknown_fields=True):
    """Environment to start."""

    containerTag: Tag
    containerData: ContainerData = ContainerData()


class NewNode(Struct, frozen=True, forbid_unknown_fields=True):
    """ROS 2 node, or nodes of a launch file, to start in the environment of the path."""

    nodeTag: Tag
    pkg: Text
    exe: str = ""
    args: str = ""
    name: str = ""
    namespace: str = ""
    existOk: bool = False
    restart: NodeRestart = ""
    launch: str = ""


class NewParameter(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameter to set or replace, for the environment of the path or one of its nodes."""

    name: ParameterName
    value: ParameterValue
    nodeTag: TagOrNone = ""


class NewRecorder(Struct, frozen=True, forbid_unknown_fields=True):
    """Recorder of topics to start in the environment of the path; without `topics`, of all of them."""

    recorderTag: Tag
    topics: Topics = []
    maxSize: Amount = 0
    maxDuration: Seconds = 0.0
    existOk: bool = False


class NewInterface(Struct, frozen=True, forbid_unknown_fields=True):
    """Interface to add to a robot (`…Converter`, `…Forwarder`) or an environment (`…Interface`)."""

    endpointTag: Tag
    interfaceTag: Tag
    interfaceType: InterfaceType
    className: TypeText
    addr: Address = ""
    qos: Qos = Qos()
    format: Format = "png"
    delivery: Delivery = Delivery()
    codec: CodecName = ""


class NewConnection(Struct, frozen=True, forbid_unknown_fields=True):
    """Two interfaces to connect, each as `endpointTag/interfaceTag`, in either order."""

    tagA: InterfaceTag
    tagB: InterfaceTag
