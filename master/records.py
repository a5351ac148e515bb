"""The command graph as records: everything that users asked for and that must outlive the Master.

    User 1─* Environment, Robot      (one name space of tags per user)
    Environment 1─* Node, Parameter
    Environment, Robot 1─* Interface
    Connection: two Interfaces of one user
    Process: Robot endpoint, Environment endpoint, task set, as it last joined
    Link: two Processes that share connections
    Package 1─* Version: a user's own ROS packages

Keys are paths (`user/env/node`). Invariants stand at the records; the functions in `graph`, `wiring` and `presence`
keep them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from ipaddress import IPv4Network
from typing import Any, Generic, Literal, Protocol, TypeVar

from msgspec import Struct

from rce.calls.endpoints import InterfaceSpec, NodeSpec, ParameterSpec
from rce.calls.environments import Egress
from rce.messages import ContainerData
from rce.roles import Principal

Role = Literal["robot", "container", "environment", "service"]
GROUP_POOL = IPv4Network("10.128.0.0/10")  # the upper half of 10/8 is seldom used; 16384 groups


class Environment(Struct, frozen=True):
    """An environment that is wanted. `run` names its present life; `machine` is the task set that has it, empty while
    it waits for one."""

    name: str  # user/tag
    options: ContainerData
    run: str
    machine: str
    subnet: str = ""  # of its network group, as 10.128.0.0/24
    address: str = ""  # in it
    packages: list[str] = []  # digests of users' packages: those that it was made with, in all of its lives
    egress: Egress = "none"

    @property
    def key(self) -> str:
        return self.name


class Robot(Struct, frozen=True):
    """A robot with a session. `endpoint` is empty while it has lost its socket and its Robot endpoint too.

    `principal` is who it proved to be when its socket opened; records of before this was kept have none. That of a
    guest (see `master.guests`) may be another than the user.
    """

    name: str  # user/robotID
    endpoint: str
    session: str  # SHA-256 of the token that resumes the session
    principal: Principal | None = None
    address: str = ""  # from where the socket came

    @property
    def by(self) -> Principal:
        """Where it is not known, somebody whom the user has given the right to be a robot."""
        return self.principal or Principal(user_of(self.name), "robot", lent=True)

    @property
    def key(self) -> str:
        return self.name


class Node(Struct, frozen=True):
    """A node that shall run in an environment."""

    owner: str
    spec: NodeSpec

    @property
    def key(self) -> str:
        return f"{self.owner}/{self.spec.tag}"


class Parameter(Struct, frozen=True):
    """A parameter of an environment, or of one of its nodes."""

    owner: str
    spec: ParameterSpec

    @property
    def key(self) -> str:
        return f"{self.owner}/{self.spec.key}"


class Interface(Struct, frozen=True):
    """An interface of a robot or an environment; its `owner` exists."""

    spec: InterfaceSpec

    @property
    def key(self) -> str:
        return f"{self.spec.owner}/{self.spec.tag}"


class Connection(Struct, frozen=True):
    """Two interfaces of one user that shall exchange messages; both exist.

    `sender` and `receiver` are keys of interfaces, by the direction of topics and of service requests. `link` is the
    data link that carries it, empty while one of the two sides is not there.
    """

    sender: str
    receiver: str
    link: str = ""

    @property
    def key(self) -> str:
        return f"{self.sender} {self.receiver}"


class Process(Struct, frozen=True):
    """A process of the platform, as it last joined; `incarnation` tells a restarted one from the one before."""

    name: str
    role: Role
    incarnation: str
    host: str = ""
    addresses: list[str] = []
    url: str = ""
    capacity: int = 0
    features: list[str] = []
    gpus: int = 0

    @property
    def key(self) -> str:
        return self.name


class Link(Struct, frozen=True):
    """A data link between two processes (or within one: `listener == dialler`, no key).

    `alone_for` is the key of the connection that has it for itself because it must not drop (keep_all).
    """

    name: str
    listener: str
    dialler: str
    incarnations: tuple[str, str]
    key_hex: str
    alone_for: str = ""

    @property
    def key(self) -> str:
        return self.name


class Version(Struct, frozen=True):
    """An archive of users' ROS packages: `digest` is the SHA-256 of its bytes, `packages` are the names of ROS."""

    digest: str
    size: int
    packages: list[str]
    created: float  # seconds since 1970


class Package(Struct, frozen=True):
    """A user's package, with at least one version, the newest last; `shared` are users who may use it, `*` is all."""

    name: str  # user/name
    versions: list[Version] = []
    shared: list[str] = []

    @property
    def key(self) -> str:
        return self.name


class Record(Protocol):
    """What a table holds."""

    @property
    def key(self) -> str: ...


T = TypeVar("T", bound=Record)


class Table(Generic[T]):
    """Records of one kind by key, and by the terms that `terms` gives; notes what changed for the store.

    Each of `watchers` is called with what was there before a change and what is there after it.
    """

    def __init__(self, kind: type[T], terms: Callable[[T], Iterable[str]]) -> None:
        self.kind = kind
        self.changed: set[str] = set()
        self.watchers: list[Callable[[T | None, T | None], None]] = []
        self._records: dict[str, T] = {}
        self._terms = terms
        self._index: dict[str, dict[str, None]] = {}  # a dict as an ordered set: effects come out in a fixed order

    def get(self, key: str) -> T | None:
        return self._records.get(key)

    def __getitem__(self, key: str) -> T:
        return self._records[key]

    def __contains__(self, key: str) -> bool:
        return key in self._records

    def __iter__(self) -> Iterator[T]:
        return iter(list(self._records.values()))

    def __len__(self) -> int:
        return len(self._records)

    def by(self, term: str) -> list[T]:
        """The records that have this term: their owner, user, side or process."""
        return [self._records[key] for key in self._index.get(term, ())]

    def count(self, term: str) -> int:
        """How many `by` would give."""
        return len(self._index.get(term, ()))

    def put(self, record: T) -> None:
        before = self._records.get(record.key)
        self.load(record)
        self.changed.add(record.key)
        self._tell(before, record)

    def load(self, record: T) -> None:
        """Put without noting a change: it comes from the store."""
        self._forget(record.key)
        self._records[record.key] = record
        for term in self._terms(record):
            self._index.setdefault(term, {})[record.key] = None

    def drop(self, key: str) -> T | None:
        record = self._forget(key)
        if record is not None:
            self.changed.add(key)
            self._tell(record, None)
        return record

    def _tell(self, before: T | None, after: T | None) -> None:
        for watcher in self.watchers:
            watcher(before, after)

    def _forget(self, key: str) -> T | None:
        record = self._records.pop(key, None)
        if record is not None:
            for term in self._terms(record):
                self._index[term].pop(key)
                if not self._index[term]:
                    del self._index[term]
        return record


def user_of(name: str) -> str:
    """The user part of `user/tag`."""
    return name.partition("/")[0]


def at(process: str) -> str:
    """The term of what is at a process; no user's name begins so."""
    return f"@{process}"


def _all_of(user: str) -> str:
    """The term of a user's connections, which no link and no interface has."""
    return f"user {user}"


def what(record: Record) -> str:
    """Names a record among all kinds: what effects settle and what commands wait for."""
    return f"{type(record).__name__} {record.key}"


class State:
    """All records, and which processes are there right now. Each network group gets a subnet out of `group_pool`."""

    def __init__(self) -> None:
        self.group_pool = GROUP_POOL
        self.environments = Table(Environment, lambda record: {user_of(record.name), at(record.machine)})
        self.robots = Table(Robot, lambda record: {user_of(record.name), at(record.endpoint)})
        self.nodes = Table(Node, lambda record: (record.owner,))
        self.parameters = Table(Parameter, lambda record: (record.owner,))
        self.interfaces = Table(Interface, lambda record: (record.spec.owner,))
        self.connections = Table(
            Connection,
            lambda record: {record.sender, record.receiver, record.link, _all_of(user_of(record.sender))} - {""},
        )
        self.processes = Table(Process, lambda record: (record.role,))
        self.links = Table(Link, lambda record: {record.listener, record.dialler})
        self.packages = Table(Package, lambda record: {user_of(record.name), *(f">{user}" for user in record.shared)})
        self.joined: set[str] = set()  # processes with a control connection
        self.expected: set[str] = set()  # those that lost it, while they have time to come back
        self.away: set[str] = set()  # robots whose socket is lost while they have time to come back

    def tables(self) -> list[Table[Any]]:
        return [
            self.environments,
            self.robots,
            self.nodes,
            self.parameters,
            self.interfaces,
            self.connections,
            self.processes,
            self.links,
            self.packages,
        ]

    def robots_of_user(self, user: str) -> int:
        """How many, without those that visit."""
        return sum(not self.visits(robot.name) for robot in self.robots.by(user))

    def connections_of_user(self, user: str) -> int:
        """How many, without those of robots that visit."""
        visitors = [robot.name for robot in self.robots.by(user) if self.visits(robot.name)]
        interfaces = [interface.key for name in visitors for interface in self.interfaces.by(name)]
        of_visitors = {connection.key for key in interfaces for connection in self.connections.by(key)}
        return len(self.connections.by(_all_of(user))) - len(of_visitors)

    def visits(self, owner: str) -> bool:
        """Whether this is a guest of somebody else than the user: it counts in none of that user's limits."""
        robot = self.robots.get(owner)
        return robot is not None and robot.by.user != user_of(owner)

    def gone(self, process: str) -> bool:
        """Whether nobody waits for this process any more."""
        return process not in self.joined and process not in self.expected

    def forget(self, process: str) -> None:
        """This process is done with, whether it is there or not."""
        self.processes.drop(process)
        self.joined.discard(process)
        self.expected.discard(process)

    def host(self, owner: str) -> str:
        """The endpoint process of a robot or environment if it is joined, else an empty string."""
        robot = self.robots.get(owner)
        process = robot.endpoint if robot else owner
        return process if process in self.joined else ""
