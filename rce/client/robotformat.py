"""A robot from a file: the JSON of the original `rce-ros`, or the same as YAML.

The keys of the entries are the argument names of the original's Python client. Unknown keys are errors.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from msgspec import Struct

from rce import structfile
from rce.messages import (
    ALIASES,
    AddInterface,
    AddNode,
    Connect,
    ContainerData,
    CreateContainer,
    InterfaceType,
    ParameterValue,
    Qos,
    SetParameter,
)


class Container(ContainerData, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An entry of `containers`: the options of an environment beside its tag."""

    cTag: str

    @property
    def command(self) -> CreateContainer:
        options = {name: getattr(self, name) for name in ContainerData.__struct_fields__}
        return CreateContainer(self.cTag, ContainerData(**options))


class Parameter(Struct, frozen=True, forbid_unknown_fields=True):
    """An entry of `parameters`."""

    cTag: str
    name: str
    value: ParameterValue

    @property
    def command(self) -> SetParameter:
        return SetParameter(self.cTag, self.name, self.value)


class Node(Struct, frozen=True, forbid_unknown_fields=True):
    """An entry of `nodes`."""

    cTag: str
    nTag: str
    pkg: str
    exe: str
    args: str = ""
    name: str = ""
    namespace: str = ""

    @property
    def command(self) -> AddNode:
        return AddNode(self.cTag, self.nTag, self.pkg, self.exe, self.args, self.name, self.namespace)


class InterfaceEntry(Struct, frozen=True, forbid_unknown_fields=True):
    """An entry of `interfaces`; `addr` counts in environments only."""

    eTag: str
    iTag: str
    iType: InterfaceType | Literal["ServiceInterface", "ServiceConverter", "ServiceForwarder"]
    iCls: str
    addr: str = ""
    qos: Qos = Qos()
    format: Literal["png", "jpeg", "json"] = "png"

    @property
    def kind(self) -> str:
        return ALIASES.get(self.iType, self.iType)

    @property
    def command(self) -> AddInterface:
        return AddInterface(self.eTag, self.iTag, self.kind, self.iCls, self.addr, self.qos, self.format)


class Connection(Struct, frozen=True, forbid_unknown_fields=True):
    """An entry of `connections`."""

    tagA: str
    tagB: str

    @property
    def command(self) -> Connect:
        return Connect(self.tagA, self.tagB)


class RobotFile(Struct, frozen=True, forbid_unknown_fields=True):
    """A robot with all that it sets up. `password` is in clear; an API `key` may stand in its place."""

    url: str
    userID: str
    robotID: str
    password: str | None = None
    key: str | None = None
    containers: list[Container] = []
    parameters: list[Parameter] = []
    nodes: list[Node] = []
    interfaces: list[InterfaceEntry] = []
    connections: list[Connection] = []


def read(path: Path) -> RobotFile:
    """The robot of a file: YAML if its name ends in `.yaml` or `.yml`, else JSON. InvalidRequest names the place."""
    return structfile.read(path, RobotFile)
