"""What processes are asked about themselves and what they run: logs, names of ROS, traffic, hops, usage, metrics."""

from __future__ import annotations

from typing import Literal

from msgspec import Struct

from rce.calls.call import Call
from rce.metrics import Family


class Log(Struct, frozen=True):
    """Lines of a node's or an environment's output. What comes later is asked for with `after=next`."""

    lines: list[str]
    next: str = ""


class ReadLog(Call[Log], frozen=True):
    """A node's output, or that of the environment itself if `node` is empty: the last lines, at most so many.

    With `after`, the `next` of an earlier answer: what has come since, in part if it is much; with `wait` answered only
    once there is something, or after so many seconds. A node that was started anew begins anew. NotFound.
    """

    node: str
    lines: int = 100
    after: str = ""
    wait: float = 0


class RosName(Struct, frozen=True):
    """A topic or service of ROS in an environment, with its types; of a topic, how many nodes publish and subscribe."""

    name: str
    types: list[str]
    publishers: int = 0
    subscribers: int = 0


class RosGraph(Struct, frozen=True):
    """What ROS has in an environment now, in the order of the names."""

    topics: list[RosName]
    services: list[RosName]


class ReadGraph(Call[RosGraph], frozen=True):
    """The topics and services of an environment."""


class Counts(Struct, frozen=True):
    """Messages and bytes of payload since the interface was made, or since two interfaces were routed to each other."""

    messages: int = 0
    bytes: int = 0
    drops: int = 0  # messages that were dropped


class InterfaceTraffic(Struct, frozen=True):
    """What has passed an interface. `sent` counts a message once, however many peers it goes to, and has all drops.

    Of each peer, by its id: what came from it, and the drops of that and of what was on the way to it.
    """

    sent: Counts
    received: Counts
    peers: dict[str, Counts] = {}


class Traffic(Struct, frozen=True):
    """By the id of the interface."""

    interfaces: dict[str, InterfaceTraffic]


class CountTraffic(Call[Traffic], frozen=True):
    """What has passed the interfaces of this endpoint."""


Hop = Literal["entered", "sent", "received", "delivered"]
"""Of a message at an endpoint: it came from the robot or ROS; begins to go out over a link; came in; went to robot or
ROS."""


class Passage(Struct, frozen=True):
    """A message at a hop, seconds since 1970 by the clock of the machine. Its id is unique for `source` only.

    `source` is the interface that it comes from; of an answer, the one that asked, so that both are joined.
    """

    source: str
    message: str
    interface: str
    hop: Hop
    time: float


class Passages(Struct, frozen=True):
    """In the order in which they were noted."""

    passages: list[Passage]


class FollowMessages(Call[Passages], frozen=True):
    """Note the hops of all messages of these interfaces, for so many seconds from now; answers what was noted before.

    Whoever follows makes up a name for it, and asks again and again.
    """

    trace: str
    interfaces: list[str]
    seconds: float = 5.0


class Used(Struct, frozen=True):
    """What an environment has used since it began: processor time in seconds; and has now: memory in bytes."""

    seconds: float
    memory: int


class Usage(Struct, frozen=True):
    """By the name of the environment; those of which nothing is known at present are left out."""

    environments: dict[str, Used]


class MeasureUsage(Call[Usage], frozen=True):
    """What the environments of this task set, or those on the node of this agent, use."""


class Metrics(Struct, frozen=True):
    """What a process counts of itself."""

    families: list[Family]


class ReadMetrics(Call[Metrics], frozen=True):
    """The metrics of this process."""
