"""Robot files: the JSON format of the original's `rce-ros`, or the same as YAML.

The keys of the entries are the argument names of the original's Python client. Unknown keys of entries are errors,
those at the top are ignored with a warning.
"""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any, Literal

import msgspec
from msgspec import Struct

from rce import structfile
from rce.protocol.messages import (
    ALIASES,
    AddInterface,
    AddNode,
    CodecName,
    Connect,
    ContainerData,
    CreateContainer,
    Decimation,
    Delivery,
    Format,
    InterfaceType,
    NodeRestart,
    ParameterValue,
    Qos,
    Rates,
    SetParameter,
)
from rce.schemas import normalized

log = logging.getLogger("rce.client")


class RatesEntry(Rates, frozen=True, forbid_unknown_fields=True):
    """`io` of an environment."""


class DecimationEntry(Decimation, frozen=True, forbid_unknown_fields=True):
    """`decimate` of a delivery."""


class DeliveryEntry(Delivery, frozen=True, forbid_unknown_fields=True):
    """`delivery` of an interface."""

    decimate: DecimationEntry = DecimationEntry()


class QosEntry(Qos, frozen=True, forbid_unknown_fields=True):
    """`qos` of an interface."""


class ContainerEntry(ContainerData, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Entry of `containers`: the name and the options of an environment."""

    cTag: str
    io: RatesEntry = RatesEntry()

    @property
    def command(self) -> CreateContainer:
        """Command that creates it."""
        options = {name: getattr(self, name) for name in ContainerData.__struct_fields__}
        return CreateContainer(self.cTag, ContainerData(**options))


class ParameterEntry(Struct, frozen=True, forbid_unknown_fields=True):
    """Entry of `parameters`."""

    cTag: str
    name: str
    value: ParameterValue

    @property
    def command(self) -> SetParameter:
        """Command that creates it."""
        return SetParameter(self.cTag, self.name, self.value)


class NodeEntry(Struct, frozen=True, forbid_unknown_fields=True):
    """Entry of `nodes`."""

    cTag: str
    nTag: str
    pkg: str
    exe: str = ""
    args: str = ""
    name: str = ""
    namespace: str = ""
    restart: NodeRestart = ""
    launch: str = ""

    @property
    def command(self) -> AddNode:
        """Command that creates it."""
        what = self.pkg, self.exe, self.args, self.name, self.namespace
        return AddNode(self.cTag, self.nTag, *what, restart=self.restart, launch=self.launch)


class InterfaceEntry(Struct, frozen=True, forbid_unknown_fields=True):
    """Entry of `interfaces`; `addr` is used by those of environments only."""

    eTag: str
    iTag: str
    iType: InterfaceType | Literal["ServiceInterface", "ServiceConverter", "ServiceForwarder"]
    iCls: str
    addr: str = ""
    qos: QosEntry = QosEntry()
    format: Format = "png"
    delivery: DeliveryEntry = DeliveryEntry()
    codec: CodecName = ""

    @property
    def kind(self) -> str:
        """Interface type, with the names that old C++ clients use replaced by the current ones."""
        return ALIASES.get(self.iType, self.iType)

    @property
    def command(self) -> AddInterface:
        """Command that creates it."""
        options = self.qos, self.format, self.delivery, self.codec
        return AddInterface(self.eTag, self.iTag, self.kind, self.iCls, self.addr, *options)


class ConnectionEntry(Struct, frozen=True, forbid_unknown_fields=True):
    """Entry of `connections`."""

    tagA: str
    tagB: str

    @property
    def command(self) -> Connect:
        """Command that creates it."""
        return Connect(self.tagA, self.tagB)


class RobotFile(Struct, frozen=True):
    """Content of a robot file: the robot, its credentials (a password in clear or an API key) and what it sets up.

    Without credentials in the file, those of the environment (RCE_KEY or RCE_PASSWORD) are used.
    """

    url: str
    userID: str
    robotID: str
    password: str | None = None
    key: str | None = None
    containers: list[ContainerEntry] = []
    parameters: list[ParameterEntry] = []
    nodes: list[NodeEntry] = []
    interfaces: list[InterfaceEntry] = []
    connections: list[ConnectionEntry] = []


def read(path: Path) -> RobotFile:
    """Read a robot file: YAML if its name ends in `.yaml` or `.yml`, else JSON.

    Unknown keys at the top are logged: files of the original may have notes of their users there.

    Raises:
        InvalidRequest: The file cannot be read or is malformed; the message names the place.
    """
    content = structfile.load(path)
    file = structfile.decode(path, content, RobotFile)
    if unknown := set(content) - set(RobotFile.__struct_fields__):
        log.warning("%s: ignored unknown keys: %s", path, ", ".join(sorted(unknown)))
    return file


def schema() -> dict[str, Any]:
    """Return the JSON Schema of robot files."""
    return normalized({"$schema": "https://json-schema.org/draft/2020-12/schema", **msgspec.json.schema(RobotFile)})


if __name__ == "__main__":
    print(json.dumps(schema(), indent=2))
