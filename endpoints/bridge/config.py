"""Configuration file of a bridge."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from rce import structfile
from rce.api.map_jobs import Mapper
from rce.client.backlog import Offline
from rce.errors import InvalidRequest
from rce.protocol.messages import ContainerData, ParameterValue, Qos

Name = Annotated[str, Meta(min_length=1)]
Rate = Annotated[float, Meta(ge=0)]


class Topic(Struct, frozen=True, forbid_unknown_fields=True):
    """A topic to forward.

    Attributes:
        to: Name at the other end; empty for the same name.
        rate: Maximum rate in Hz, beyond which messages are left out; 0 for all messages.
        format: Compression of images on the way; empty leaves messages unchanged.
        offline: Treatment of messages to the cloud while the robot is offline: drop them, keep the newest one, or store
            them (64 MiB at most) and send them in their order when it is back. Those from the cloud are not kept.
        store: File in which they are stored, so that they outlast the bridge; for `offline: store`.
    """

    topic: Name
    type: Name
    to: str = ""
    rate: Rate = 0
    format: Literal["", "png", "jpeg"] = ""
    qos: Qos = Qos()
    offline: Offline = "drop"
    store: Path | None = None


class Service(Struct, frozen=True, forbid_unknown_fields=True):
    """A service that nodes at the other end may call; `to` is its name there, empty for the same name."""

    service: Name
    type: Name
    to: str = ""


class RosAction(Struct, frozen=True, forbid_unknown_fields=True):
    """An action that nodes at the other end may use; `to` is its name there, empty for the same name.

    `cancel_if_lost`: goals are canceled when the bridge's session ends; without it they go on.
    """

    action: Name
    type: Name
    to: str = ""
    cancel_if_lost: bool = False


class Transforms(Struct, frozen=True, forbid_unknown_fields=True):
    """Transforms to forward, by child frame; `rate` is the maximum rate of each in Hz, 0 for all messages."""

    frames: list[Name]
    rate: Rate = 0


class Direction(Struct, frozen=True, forbid_unknown_fields=True):
    """Topics and transforms to forward in one direction; services and actions, which the other end uses."""

    topics: list[Topic] = []
    services: list[Service] = []
    actions: list[RosAction] = []
    tf: Transforms | None = None


class Node(Struct, frozen=True, forbid_unknown_fields=True):
    """A node that the bridge adds to the environment."""

    tag: Name
    pkg: Name
    exe: str = ""
    args: str = ""
    name: str = ""
    namespace: str = ""
    launch: str = ""


class EnvironmentConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The environment in the cloud.

    With `create` the bridge creates it with these options and destroys it at the end. Without, it must exist.
    """

    tag: Name
    create: ContainerData | None = None
    nodes: list[Node] = []
    parameters: dict[str, ParameterValue] = {}


class StartOffloading(Struct, frozen=True, forbid_unknown_fields=True, tag_field="action", tag="start"):
    """Create the environment and open all flows."""


class StopOffloading(Struct, frozen=True, forbid_unknown_fields=True, tag_field="action", tag="stop"):
    """Close all flows, and destroy the environment if the bridge created it."""


class Record(Struct, frozen=True, forbid_unknown_fields=True, tag_field="action", tag="record"):
    """Begin to record topics (name: type) into a bag in `directory`."""

    topics: dict[str, str]
    directory: Path


class EndRecording(Struct, frozen=True, forbid_unknown_fields=True, tag_field="action", tag="end_record"):
    """End the recording that is in progress."""


class BuildMap(Struct, frozen=True, forbid_unknown_fields=True, tag_field="action", tag="build_map"):
    """Have the map service build a map of the last recording, after ending one that is in progress.

    Attributes:
        topic: Topic on which the map is published, latched.
        mapper: Mapping algorithm.
        scan: Topic of the laser scans, for a recording with several.
        odometry: Topic of the odometry, for a recording with several.
        out: Directory for the files of the map; None to discard them.
    """

    topic: str = "/cloud_map"
    mapper: Mapper = "graph"
    scan: str = ""
    odometry: str = ""
    out: Path | None = None


Action = StartOffloading | StopOffloading | Record | EndRecording | BuildMap


class BridgeConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Configuration of a bridge.

    Attributes:
        password: Password in clear text; prefer an API key in the variable RCE_KEY.
        compress: True to compress the WebSocket with deflate.
        offload: False to wait for a request to start offloading.
        send: Flows from the robot's ROS to the environment.
        receive: Flows from the environment to the robot's ROS.
        requests: Actions that nodes of the robot can request, by id.
        metrics: Port for `/metrics`, on all addresses; 0 for none.
    """

    url: Name
    user: Name
    robot: Name
    environment: EnvironmentConfig
    password: str | None = None
    key: str | None = None
    compress: bool = False
    offload: bool = True
    send: Direction = Direction()
    receive: Direction = Direction()
    requests: dict[str, Action] = {}
    metrics: Annotated[int, Meta(ge=0, le=65535)] = 0


def read(path: Path, environment: dict[str, str] | None = None) -> BridgeConfig:
    """Read a YAML or JSON file; RCE_KEY or RCE_PASSWORD replace a missing credential.

    Args:
        path: The file.
        environment: Environment variables; None for those of the process.

    Raises:
        InvalidRequest: The file is not valid; the message names the file and the position.
    """
    config = structfile.read(path, BridgeConfig)
    _check(config, str(path))
    variables = os.environ if environment is None else environment
    if config.key is None and config.password is None:
        key = variables.get("RCE_KEY")
        config = msgspec.structs.replace(config, key=key, password=None if key else variables.get("RCE_PASSWORD"))
    if (config.key is None) == (config.password is None):
        raise InvalidRequest(f"{path}: give either key or password, or set RCE_KEY or RCE_PASSWORD", field="key")
    return config


def _check(config: BridgeConfig, where: str) -> None:
    for way in ("send", "receive"):
        direction: Direction = getattr(config, way)
        for number, topic in enumerate(direction.topics):
            place = f"{way}.topics[{number}]"
            if topic.qos.history == "keep_all":
                raise InvalidRequest(
                    f"{where}: {place}.qos: a bridge keeps only the newest messages: use keep_last", field=place
                )
            if way == "receive" and topic.offline != "drop":
                raise InvalidRequest(f"{where}: {place}.offline is only for topics to send", field=place)
            if topic.store is not None and topic.offline != "store":
                raise InvalidRequest(f"{where}: {place}.store needs offline: store", field=place)
            if topic.format and topic.type.replace("/msg/", "/") != "sensor_msgs/Image":
                raise InvalidRequest(f"{where}: {place}.format is only for sensor_msgs/Image", field=place)
        if direction.tf is not None and not direction.tf.frames:
            raise InvalidRequest(f"{where}: {way}.tf.frames is empty: list the child frames", field=f"{way}.tf.frames")
