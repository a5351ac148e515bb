"""Types of the catalogue: how a service is declared (`service.yaml`), and what the catalogue shows of it."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from rce.protocol.messages import ContainerData, NodeRestart, ParameterName, ParameterValue, Qos
from rce.protocol.names import Tag, TagOrNone, Text, TypeText

Short = Annotated[str, Meta(max_length=255)]
Share = Annotated[list[str], Meta(max_length=1000)]
Bound = Annotated[int, Meta(ge=0, le=1000)]


class OfferedPort(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A topic, service or action of a service of the catalogue.

    A relative `address`, by default the name, is in the robot's namespace if the instance is shared.
    """

    type: TypeText
    address: Short = ""
    qos: Qos = Qos()


Ports = Annotated[dict[Tag, OfferedPort | TypeText], Meta(max_length=50)]


class OfferedNode(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A node of a service; with `perRobot` a shared instance has one for each robot, in the robot's namespace."""

    nodeTag: Tag
    pkg: Text
    exe: Text
    args: Annotated[str, Meta(max_length=32_768)] = ""
    name: Short = ""
    namespace: Short = ""
    restart: NodeRestart = ""
    perRobot: bool = False
    parameters: dict[ParameterName, ParameterValue] = {}


class NewOffer(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Declaration of a service.

    Args:
        name: Its name in the catalogue.
        description: What it does, in a sentence.
        takes: Topics on which it takes messages of robots, by name; each is a type, or a type with address and QoS.
        gives: Topics on which it gives messages to robots.
        services: ROS services that robots call.
        actions: ROS actions to which robots send goals.
        nodes: Nodes to start.
        parameters: Parameters of all of these nodes.
        environment: Options of the environment of an instance.
        robots: Robots that an instance serves; with more than one it is shared, also by robots of several users.
        least: Shared instances that always run.
        most: Shared instances at most.
        mostPerUser: Robots of one user at most; 0 for no limit.
        idle: Seconds after which an instance without robots is stopped.
        share: Users who may use it; `*` is everybody.
    """

    name: Tag
    description: Annotated[str, Meta(max_length=2000)] = ""
    takes: Ports = {}
    gives: Ports = {}
    services: Ports = {}
    actions: Ports = {}
    nodes: Annotated[list[OfferedNode], Meta(max_length=50)] = []
    parameters: dict[ParameterName, ParameterValue] = {}
    environment: ContainerData = ContainerData()
    robots: Annotated[int, Meta(ge=1, le=1000)] = 1
    least: Bound = 0
    most: Annotated[int, Meta(ge=1, le=1000)] = 1
    mostPerUser: Bound = 0
    idle: Annotated[float, Meta(ge=0, le=30 * 86_400)] = 300.0
    share: Share = msgspec.field(default_factory=lambda: ["*"])


class Scale(Struct, frozen=True, forbid_unknown_fields=True):
    """Bounds for the number of shared instances."""

    least: Bound
    most: Annotated[int, Meta(ge=1, le=1000)]


class NewUse(Struct, frozen=True, forbid_unknown_fields=True):
    """Use of a service by a connected robot of the user; without `robot` an instance of the user's own is started."""

    robot: TagOrNone = ""
    containerTag: TagOrNone = ""


class InstanceView(Struct, frozen=True):
    """Environment that runs a service, with its robots; `current` is false if the service was published again since."""

    user: str
    containerTag: str
    state: str
    robots: list[str]  # user/robotID
    current: bool


class OfferView(Struct, frozen=True):
    """A service in the catalogue.

    Only its publisher sees `share`, the `instances` of other users than the caller, and `uses`: how often the robots of
    each user began to use it.
    """

    user: str  # the publisher; `@rce` for those that come with RCE
    service: NewOffer
    instances: list[InstanceView]
    uses: dict[str, int]
