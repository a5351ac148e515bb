"""What users ask the HTTP API for: the items of CC, CN and CX, less what the path says already."""

from __future__ import annotations

from typing import Literal

from msgspec import Struct

from rce.messages import (
    ContainerData,
    InterfaceTag,
    InterfaceType,
    ParameterName,
    ParameterValue,
    Qos,
    Tag,
    TagOrNone,
    Text,
    TypeText,
)


class NewEnvironment(Struct, frozen=True, forbid_unknown_fields=True):
    """An environment to start."""

    containerTag: Tag
    containerData: ContainerData = ContainerData()


class NewNode(Struct, frozen=True, forbid_unknown_fields=True):
    """A ROS 2 node to start in the environment of the path."""

    nodeTag: Tag
    pkg: Text
    exe: Text
    args: str = ""
    name: str = ""
    namespace: str = ""


class NewParameter(Struct, frozen=True, forbid_unknown_fields=True):
    """A parameter to set, in place of one of the same name, for the environment of the path or one node of it."""

    name: ParameterName
    value: ParameterValue
    nodeTag: TagOrNone = ""


class NewInterface(Struct, frozen=True, forbid_unknown_fields=True):
    """An interface to add to a robot (`…Converter`, `…Forwarder`) or an environment (`…Interface`)."""

    endpointTag: Tag
    interfaceTag: Tag
    interfaceType: InterfaceType
    className: TypeText
    addr: str = ""
    qos: Qos = Qos()
    format: Literal["png", "jpeg", "json"] = "png"


class NewConnection(Struct, frozen=True, forbid_unknown_fields=True):
    """Two interfaces to connect, each `endpointTag/interfaceTag`, in either order."""

    tagA: InterfaceTag
    tagB: InterfaceTag
