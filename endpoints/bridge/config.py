"""What a bridge does, as its file says it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from rce import structfile
from rce.errors import InvalidRequest
from rce.map_jobs import Mapper
from rce.messages import ContainerData, ParameterValue, Qos

Name = Annotated[str, Meta(min_length=1)]
Rate = Annotated[float, Meta(ge=0)]


class Topic(Struct, frozen=True, forbid_unknown_fields=True):
    """A topic that is carried on. `to` is its name at the other end, empty: the same.

    `rate` in Hz: what comes sooner is left out; 0: everything. `format` is for images: `png` and `jpeg` are compressed
    on their way, empty leaves every message as it is.
    """

    topic: Name
    type: Name
    to: str = ""
    rate: Rate = 0
    format: Literal["", "png", "jpeg"] = ""
    qos: Qos = Qos()


class Service(Struct, frozen=True, forbid_unknown_fields=True):
    """A service that nodes at the other end may call; `to` is its name there, empty: the same."""

    service: Name
    type: Name
    to: str = ""


class Transforms(Struct, frozen=True, forbid_unknown_fields=True):
    """Transforms that are carried on, each by its child frame; `rate` in Hz is for each of them, 0: everything."""

    frames: list[Name]
    rate: Rate = 0


class Direction(Struct, frozen=True, forbid_unknown_fields=True):
    """What is carried one way: topics, services that the other end may call, and transforms."""

    topics: list[Topic] = []
    services: list[Service] = []
    tf: Transforms | None = None


class Node(Struct, frozen=True, forbid_unknown_fields=True):
    """A node that the bridge starts in the environment."""

    tag: Name
    pkg: Name
    exe: Name
    args: str = ""
    name: str = ""
    namespace: str = ""


class EnvironmentConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The environment in the cloud. With `create`, the bridge makes it with these options and destroys it at the end;
    without, it is another's.
    """

    tag: Name
    create: ContainerData | None = None
    nodes: list[Node] = []
    parameters: dict[str, ParameterValue] = {}


class StartOffloading(Struct, frozen=True, forbid_unknown_fields=True, tag_field="action", tag="start"):
    """Make the environment and carry what is to be carried."""


class StopOffloading(Struct, frozen=True, forbid_unknown_fields=True, tag_field="action", tag="stop"):
    """Carry nothing more, and destroy the environment if the bridge made it."""


class Record(Struct, frozen=True, forbid_unknown_fields=True, tag_field="action", tag="record"):
    """Begin to record topics (name: type) into a bag in `directory`."""

    topics: dict[str, str]
    directory: Path


class EndRecording(Struct, frozen=True, forbid_unknown_fields=True, tag_field="action", tag="end_record"):
    """End the recording that runs."""


class BuildMap(Struct, frozen=True, forbid_unknown_fields=True, tag_field="action", tag="build_map"):
    """Have the cloud build a map of what was recorded last (ends a recording that runs).

    The map is published on `topic`, latched; with `out` its files are written there. `scan` and `odometry` name topics
    of a recording that has several of these types.
    """

    topic: str = "/cloud_map"
    mapper: Mapper = "graph"
    scan: str = ""
    odometry: str = ""
    out: Path | None = None


Action = StartOffloading | StopOffloading | Record | EndRecording | BuildMap


class BridgeConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """A bridge. `password` is in clear; better is an API key in the variable RCE_KEY.

    `send` goes from the robot's ROS to the environment, `receive` the other way. `requests` are what nodes of the robot
    may ask for by these ids. `compress` deflates all that goes through the WebSocket. `offload: false` waits for a
    request to start. `metrics` is the port of this machine at which Prometheus finds /metrics, 0: none.
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
    """The bridge of a YAML or JSON file; RCE_KEY or RCE_PASSWORD stand in for a credential that the file lacks.

    InvalidRequest names the file and the place.
    """
    config = structfile.read(path, BridgeConfig)
    _check(config, str(path))
    variables = os.environ if environment is None else environment
    if config.key is None and config.password is None:
        key = variables.get("RCE_KEY")
        config = msgspec.structs.replace(config, key=key, password=None if key else variables.get("RCE_PASSWORD"))
    if (config.key is None) == (config.password is None):
        raise InvalidRequest(f"{path}: give a key or a password, or set RCE_KEY or RCE_PASSWORD", field="key")
    return config


def _check(config: BridgeConfig, where: str) -> None:
    for way in ("send", "receive"):
        direction: Direction = getattr(config, way)
        for number, topic in enumerate(direction.topics):
            place = f"{way}.topics[{number}]"
            if topic.qos.history == "keep_all":
                raise InvalidRequest(f"{where}: {place}.qos: a bridge keeps the newest messages, not all", field=place)
            if topic.format and topic.type.replace("/msg/", "/") != "sensor_msgs/Image":
                raise InvalidRequest(f"{where}: {place}.format is for sensor_msgs/Image only", field=place)
        if direction.tf is not None and not direction.tf.frames:
            raise InvalidRequest(f"{where}: {way}.tf.frames is empty: name the child frames", field=f"{way}.tf.frames")
