"""What watchers of the platform are sent: the graph as it changes (`/live`), and what happened (`/events`)."""

from __future__ import annotations

from typing import Any, Literal

from msgspec import Struct

Kind = Literal["robots", "environments", "nodes", "parameters", "interfaces", "connections", "groups", "machines"]


class Greeting(Struct, frozen=True, forbid_unknown_fields=True):
    """The first message that a watcher sends at `/live`: an API key, and what it wants to see of whom.

    `user` is as in lists: empty is the key's own user, `*` everybody whom the key may see. No kinds: all of them.
    """

    key: str
    user: str = ""
    kinds: list[Kind] = []


class Deltas(Struct, frozen=True, omit_defaults=True):
    """What has changed, of each kind: the views that are new or different by key, and the keys of those that are gone.

    A `snapshot` is all that there is: what the watcher has besides is gone. It comes first, and again when the watcher
    was too slow to be told of each change. `seq` counts the messages of a connection from 1.

    Keys are `user/robotID`, `user/containerTag`, `user/containerTag/nodeTag`, `user/containerTag/nodeTag:name`,
    `user/endpointTag/interfaceTag`, both of these with a blank between for a connection, `user/group`, and a machine's
    name.
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
    "connection.made",
    "connection.gone",
    "limit.reached",
    "machine.joined",
    "machine.left",
]
"""`missed`: events before this one are not kept any more. An environment that did not start has `failed`, one that
ended by itself is `lost`, and it is `gone` when nobody wants it any more."""


class Event(Struct, frozen=True, omit_defaults=True):
    """Something that happened, as `/events` tells it: the `type` is the event's name, `id` its id.

    `object` is what it happened to, by its key as in `Deltas`.
    """

    id: str
    time: float
    type: EventType
    user: str  # whose it is; empty for a machine
    object: str
    text: str = ""  # for people: the reason
    status: int | None = None  # of a node: its exit status, negative the signal that ended it
    lines: list[str] = []  # of a node: its last output
