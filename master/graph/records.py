"""Records of the command graph: everything that users asked for and that must outlive the Master.

    User 1─* Environment, Robot      (one name space of tags per user)
    Environment 1─* Node, Parameter, Recorder; Node 1─? NodeEnd, which outlives it
    Environment, Robot 1─* Interface
    Connection: two Interfaces of one user
    Waiting: a Connection of which an Interface is away
    Process: Robot endpoint, Environment endpoint, task set, as it last joined
    Link: two Processes that share connections
    Package 1─* Version: a user's own ROS packages
    Offer, Instance, Use, Tally: the catalogue of services (`catalogue_records`)

Keys are paths (`user/env/node`). Invariants are documented at the records; `commands`, `changes`, `wiring` and
`reconcile` keep them. The database stores records as JSON, so they share no type with messages or control calls:
`translation` converts between them.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, Protocol

from msgspec import Struct

from rce.api.egress import Egress
from rce.api.roles import Principal

Role = Literal["robot", "container", "environment", "service"]
NodeRestart = Literal["", "on-failure", "always", "no"]
ParameterValue = bool | int | float | str | list[Any] | dict[str, Any]


class Ref(NamedTuple):
    """Typed reference to a record: its kind in lower case, and its key."""

    kind: str
    key: str

    def __str__(self) -> str:
        return f"{self.kind} {self.key}"


class IoRates(Struct, frozen=True, omit_defaults=True):
    """Limits of reading and writing in bytes a second; 0 is no limit."""

    read: int = 0
    write: int = 0


class EnvironmentOptions(Struct, frozen=True, omit_defaults=True):
    """Options of an environment after limits and defaults were applied; 0 or empty leaves a value to the engine.

    `size` is in slots of a machine, `cpu` in cores, `memory` and `disk` in bytes, `bandwidth` in bytes a second.
    """

    image: str = ""
    size: int = 1
    cpu: float = 0
    memory: int = 0
    pids: int = 0
    disk: int = 0
    bandwidth: int = 0
    io: IoRates = IoRates()
    gpus: int = 0
    features: list[str] = []
    variables: dict[str, str] = {}
    secrets: dict[str, str] = {}  # variable, or an empty string, by the name of the user's secret
    packages: list[str] = []  # references as the user wrote them
    group: str = ""
    group_address: str = ""  # as the user wrote it
    restart: Literal["always", "no"] = "always"


class Environment(Struct, frozen=True):
    """An environment that a user wants.

    `run` identifies its current life. `machine` is the task set that runs it, empty while it waits for one.
    """

    name: str  # user/tag
    options: EnvironmentOptions
    run: str
    machine: str
    subnet: str = ""  # of its network group, as 10.128.0.0/24
    address: str = ""  # in that subnet
    packages: list[str] = []  # digests of users' packages, resolved once: the same in all of its lives
    egress: Egress = "none"

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return self.name


class Robot(Struct, frozen=True):
    """A robot with a session.

    `endpoint` is empty after its Robot endpoint was lost, until the robot resumes at another one. `principal` is the
    identity that it proved when its socket opened; records of version 0.1 lack it. A guest's (see
    `master.access.guests`) may be another user than the owner.
    """

    name: str  # user/robotID
    endpoint: str
    session: str  # SHA-256 of the token that resumes the session
    principal: Principal | None = None
    address: str = ""  # from which the socket was opened
    previous: str = ""  # SHA-256 of the token before, valid until the new one is used: the robot may not have got it
    events: bool = False  # it asked for the feature `events`, and so for statuses of its user's things

    @property
    def by(self) -> Principal:
        """Return the principal; without one, a lent right of the user to be a robot."""
        return self.principal or Principal(user_of(self.name), "robot", lent=True)

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return self.name


class Node(Struct, frozen=True):
    """A ROS 2 node that a user wants to run in an environment.

    With `launch` it is a launch, whose nodes are records with its tag as `part_of`. These come and go as the
    environment reports.
    """

    owner: str  # the environment
    tag: str
    package: str
    executable: str
    arguments: str = ""
    name: str = ""
    namespace: str = ""
    restart: NodeRestart = ""
    launch: str = ""  # launch file, in place of an executable
    part_of: str = ""  # tag of the launch

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return f"{self.owner}/{self.tag}"


class NodeEnd(Struct, frozen=True):
    """The last end of a node that was not stopped; of one that still exists, it was started again."""

    node: Node
    status: int  # negative: the signal that killed it
    lines: list[str]  # the last ones of its output
    time: float  # seconds since 1970
    count: int = 1  # ends since a user started it

    @property
    def owner(self) -> str:
        """Return the environment."""
        return self.node.owner

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return self.node.key


class Parameter(Struct, frozen=True):
    """A ROS 2 parameter of all nodes of an environment, or of one node (`node` is its tag)."""

    owner: str  # the environment
    name: str
    value: ParameterValue
    node: str = ""

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return parameter_key(self.owner, self.node, self.name)


class Recorder(Struct, frozen=True, omit_defaults=True):
    """A recorder of topics of an environment, of all of them if `topics` is empty; 0 is no limit of one file."""

    owner: str  # the environment
    tag: str
    topics: list[str] = []
    max_size: int = 0  # bytes
    max_duration: float = 0.0  # seconds

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return f"{self.owner}/{self.tag}"


class Qos(Struct, frozen=True, omit_defaults=True):
    """Quality of service of an interface, in the terms of ROS 2; `auto` follows what the topic has already."""

    reliability: Literal["auto", "reliable", "best_effort"] = "auto"
    durability: Literal["auto", "volatile", "transient_local"] = "auto"
    history: Literal["keep_last", "keep_all"] = "keep_last"
    depth: int = 0


class Delivery(Struct, frozen=True, omit_defaults=True):
    """Treatment of the messages of a topic on the line between a robot and the cloud; 0 is no limit.

    Without `fields`, messages have all; `step` and `size` (width, height in pixels) decimate them.
    """

    priority: Literal["high", "normal", "low"] = "normal"
    max_age: float = 0.0  # seconds
    rate: float = 0.0  # messages per second
    fields: tuple[str, ...] = ()
    step: int = 1
    size: tuple[int, int] | None = None


class Interface(Struct, frozen=True):
    """An interface of a robot or an environment; its `owner` exists.

    `id` (32 hex) identifies it in data frames: an interface that is added again under its old name has another. `by` is
    the robot that added it to an environment, else empty.
    """

    id: str
    owner: str
    tag: str
    kind: str  # as PublisherConverter
    type: str  # className, in the spelling that the user gave
    address: str = ""  # topic or service name
    qos: Qos = Qos()
    format: str = "png"
    by: str = ""
    delivery: Delivery = Delivery()
    codec: str = ""

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return f"{self.owner}/{self.tag}"


class Connection(Struct, frozen=True):
    """Two interfaces that exchange messages; both exist and are one user's, or one is of another user's instance.

    `sender` and `receiver` are keys of interfaces, in the direction of topic messages and service requests. `link` is
    the data link that carries it, empty while one of the two sides is absent. `by` is the robot that asked for it if
    one of the ends is its own, else empty. `restored`: it is back after it waited for an end; whoever declares it again
    gets no error. `guest_user` is the user of the robot if the other end is in another user's instance.
    """

    sender: str
    receiver: str
    link: str = ""
    by: str = ""
    restored: bool = False
    guest_user: str = ""

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return f"{self.sender} {self.receiver}"

    @property
    def user(self) -> str:
        """Return the user whose connection it is."""
        return self.guest_user or user_of(self.sender)


class Waiting(Struct, frozen=True):
    """A connection that is back when an end that left is added again by its name; `by` is as in `Connection`."""

    sender: str
    receiver: str
    by: str = ""

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return f"{self.sender} {self.receiver}"


class Process(Struct, frozen=True):
    """A process of the platform, as it last joined; `incarnation` tells a restarted process from its predecessor.

    A task set knows how its environments are dialled: `sockets` is the path of an environment's socket, with {name},
    {user} and {run}, and `relays` has the HOST:PORT of the data relay on each host. Its `host` is empty if it has
    several hosts. `not_enforced` are the options of environments that have no effect there.
    """

    name: str
    role: Role
    incarnation: str
    host: str = ""
    addresses: list[str] = []
    url: str = ""
    capacity: int = 0
    features: list[str] = []
    gpus: int = 0
    sockets: str = ""
    relays: dict[str, str] = {}
    not_enforced: list[str] = []

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return self.name


class Link(Struct, frozen=True):
    """A data link between two processes, or within one (`listener == dialler`, no key).

    `alone_for` is the key of the connection that has the link for itself because it must not drop (keep_all).
    """

    name: str
    listener: str
    dialler: str
    incarnations: tuple[str, str]
    key_hex: str
    alone_for: str = ""

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return self.name


class Version(Struct, frozen=True):
    """An archive of ROS packages: `digest` is the SHA-256 of its bytes, `packages` are their names in ROS."""

    digest: str
    size: int
    packages: list[str]
    created: float  # seconds since 1970


class Package(Struct, frozen=True):
    """A user's package with at least one version, the newest last; `shared` lists who may use it, `*` is everybody."""

    name: str  # user/name
    versions: list[Version] = []
    shared: list[str] = []

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return self.name


class Secret(Struct, frozen=True):
    """A user's secret, sealed with the key of the platform."""

    name: str  # user/name
    sealed: str
    created: float  # seconds since 1970

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return self.name


class Record(Protocol):
    """Interface of all records."""

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""


def user_of(name: str) -> str:
    """Return the user part of `user/tag`."""
    return name.partition("/")[0]


def parameter_key(owner: str, node: str, name: str) -> str:
    """Return the key of a parameter of one node, or of all nodes if `node` is empty."""
    return f"{owner}/{node}:{name}"


def ref(record: Record) -> Ref:
    """Return the reference of a record: effects mark references ready and commands wait for them."""
    return Ref(type(record).__name__.lower(), record.key)
