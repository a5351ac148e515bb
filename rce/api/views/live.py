"""Messages to watchers of the platform: changes of the graph (`/live`) and events (`/events`)."""

from __future__ import annotations

from typing import Any, Literal

from msgspec import Struct

Kind = Literal[
    "robots",
    "environments",
    "nodes",
    "parameters",
    "recorders",
    "interfaces",
    "connections",
    "groups",
    "machines",
]


class Greeting(Struct, frozen=True, forbid_unknown_fields=True):
    """First message of a watcher at `/live`: an API key, and the users and kinds of resources to watch.

    `user` is as in lists: empty for the key's own user, `*` for all users whom the key may see. No kinds means all.
    """

    key: str
    user: str = ""
    kinds: list[Kind] = []


class Deltas(Struct, frozen=True, omit_defaults=True):
    """Changes by kind: `put` has new and changed views by key, `drop` the keys of removed ones.

    A `snapshot` is complete: anything else that the watcher has no longer exists. It is the first message, and is sent
    again when the watcher was too slow for the single changes. `seq` counts the messages of a connection from 1.

    Keys are `user/robotID`, `user/containerTag`, `user/containerTag/nodeTag`, `user/containerTag/nodeTag:name`,
    `user/containerTag/recorderTag`,
    `user/endpointTag/interfaceTag`, two of these with a space between them for a connection, `user/group`, and a
    machine's name.
    """

    seq: int
    snapshot: bool = False
    put: dict[Kind, dict[str, Any]] = {}
    drop: dict[Kind, list[str]] = {}


EventType = Literal[
    "missed",
    "robot.came",
    "robot.left",
    "environment.ready",
    "environment.failed",
    "environment.lost",
    "environment.gone",
    "node.died",
    "recorder.ended",
    "connection.made",
    "connection.gone",
    "interface.gone",
    "limit.reached",
    "knowledge.added",
    "knowledge.changed",
    "knowledge.removed",
    "machine.joined",
    "machine.left",
]
"""Types of events.

`missed`: earlier events are no longer stored. An environment that did not start is `failed`, one that ended by itself
is `lost`, and one that was destroyed is `gone`. A recorder that `ended` did so by itself. An interface of an
environment is `gone` after the robot that added it has left and nobody else uses it. Of an entry of the knowledge
repository its author is told, and if it is public everybody; of many changes at once one event for each author tells
the number.
"""


class Event(Struct, frozen=True, omit_defaults=True):
    """Event of `/events`; its `type` and `id` are also those of the server-sent event.

    `object` is the key of the resource, as in `Deltas`.
    """

    id: str
    time: float
    type: EventType
    user: str  # owner of the object; empty for a machine
    object: str
    text: str = ""  # human-readable reason
    status: int | None = None  # exit status of a node; negative for the signal that ended it
    lines: list[str] = []  # last lines of a node's output
    public: bool = False  # it concerns all users
