"""Statuses, events and errors that the platform sends to robots: the frames ST and ER."""

from __future__ import annotations

from typing import Literal

from msgspec import UNSET, Struct, UnsetType

from rce.errors import ErrorInfo
from rce.protocol.messages.frames import FrameId


class InterfaceStatus(Struct, frozen=True, tag_field="topic", tag="iu"):
    """The robot's interface got its first connection, or lost its last one."""

    iTag: str
    status: bool


class UsedInterface(Struct, frozen=True):
    """Interface of the robot that is connected to a service; `name` is that in the declaration of the service."""

    name: str
    iTag: str
    interfaceType: str
    className: str


class UsedService(Struct, frozen=True):
    """A service of the catalogue in which the robot takes part, and its interfaces for that.

    `containerTag` names the robot's part; the instance of a service that is not shared is the environment of that name.
    """

    service: str  # user/name
    containerTag: str
    shared: bool
    interfaces: list[UsedInterface]


class Ack(Struct, frozen=True, tag_field="topic", tag="ack", omit_defaults=True):
    """The frame with the same `id` has been executed; `services` answer its `useServices`."""

    services: list[UsedService] = []


class Session(Struct, frozen=True, tag_field="topic", tag="session"):
    """First ST of a connection with features: the features that the server granted and, with `resume`, the token.

    `resumed` is true if the interfaces and connections of an earlier socket still exist. `interfaces` then has the
    status of each, since status messages may have been lost when that socket broke. `grace` is the grace period of a
    session without a socket, in seconds. `incarnation` is that of the Robot endpoint, which knows the streams of the
    robot (see `DataMessage`) until its own end.
    """

    features: list[str]
    token: str = ""
    grace: float = 0
    resumed: bool = False
    interfaces: dict[str, bool] = {}
    incarnation: str = ""


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


class RecorderEvent(Struct, frozen=True, tag_field="topic", tag="recorder"):
    """A recorder ended by itself: a quota or a disk is full, for example. What it recorded is kept."""

    containerTag: str
    recorderTag: str
    reason: str


class DropEvent(Struct, frozen=True, tag_field="topic", tag="drops"):
    """Number of messages of an interface that were dropped since it was added, because a queue was full.

    `iTag` is an interface of the robot, or with `containerTag/` before it one of an environment to which the robot is
    connected.
    """

    iTag: str
    count: int
    where: str


ConnectionState = Literal["waiting", "restored", "gone"]


class ConnectionEvent(Struct, frozen=True, tag_field="topic", tag="connection"):
    """A connection that this robot asked for waits for an end that is away, is restored, or is gone."""

    tagA: str
    tagB: str
    state: ConnectionState
    reason: str = ""


class LimitEvent(Struct, frozen=True, tag_field="topic", tag="limit"):
    """A limit was reached; the socket stays open unless the reason says otherwise."""

    reason: str


StatusData = (
    InterfaceStatus
    | Ack
    | Session
    | EnvironmentEvent
    | NodeEvent
    | RecorderEvent
    | DropEvent
    | ConnectionEvent
    | LimitEvent
)


class Status(Struct, frozen=True, tag_field="type", tag="ST", omit_defaults=True):
    """ST: a status, by the `topic` of its `data`. A robot without features gets only the topic `iu`."""

    data: StatusData
    id: FrameId | UnsetType = UNSET


class Failure(Struct, frozen=True, tag_field="type", tag="ER", omit_defaults=True):
    """ER: an error as a plain string, as in the original; robots with features also get `id` and `error`."""

    data: str
    id: FrameId | UnsetType = UNSET
    error: ErrorInfo | UnsetType = UNSET
