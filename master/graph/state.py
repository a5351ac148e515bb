"""State of the graph: tables of all records, and which processes are connected."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from ipaddress import IPv4Network
from typing import Any, Generic, TypeVar

from master.graph.catalogue_records import Instance, Offer, Tally, Use
from master.graph.records import (
    Connection,
    Environment,
    EnvironmentOptions,
    Interface,
    Link,
    Node,
    NodeEnd,
    Package,
    Parameter,
    Process,
    Record,
    Recorder,
    Ref,
    Robot,
    Secret,
    Waiting,
    user_of,
)
from rce.protocol import slots

GROUP_POOL = IPv4Network("10.128.0.0/10")  # the upper half of 10/8 is seldom used; 16384 groups

T = TypeVar("T", bound=Record)


class Table(Generic[T]):
    """Records of one kind, indexed by key and by the terms that `terms` returns for a record.

    It keeps the sums, by term, of the amounts that `amounts` returns for a record. `changed` collects keys for the
    store. Each of `watchers` is called with the record before and after a change.
    """

    def __init__(
        self,
        kind: type[T],
        terms: Callable[[T], Iterable[str]],
        amounts: Callable[[T], Mapping[str, float]] = lambda _: {},
    ) -> None:
        self.kind = kind
        self.changed: set[str] = set()
        self.watchers: list[Callable[[T | None, T | None], None]] = []
        self._records: dict[str, T] = {}
        self._terms = terms
        self._amounts = amounts
        self._index: dict[str, dict[str, None]] = {}  # a dict as an ordered set keeps the order of effects fixed
        self._sums: dict[str, Counter[str]] = {}  # by term

    def get(self, key: str) -> T | None:
        """Return a record, or None."""
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
        """Return the records that have this term: an owner, user, side or process."""
        return [self._records[key] for key in self._index.get(term, ())]

    def count(self, term: str) -> int:
        """Count the records that `by` would return."""
        return len(self._index.get(term, ()))

    def total(self, term: str, amount: str) -> float:
        """Return the sum of an amount over the records that `by` would return."""
        return round(self._sums[term][amount], 6) if term in self._sums else 0.0  # sums of fractions are not exact

    def put(self, record: T) -> None:
        """Add or replace a record."""
        before = self._records.get(record.key)
        self.load(record)
        self.changed.add(record.key)
        self._notify(before, record)

    def load(self, record: T) -> None:
        """Add a record that comes from the store, which is not a change."""
        self._forget(record.key)
        self._records[record.key] = record
        amounts = self._amounts(record)
        for term in self._terms(record):
            self._index.setdefault(term, {})[record.key] = None
            if amounts:
                self._sums.setdefault(term, Counter()).update(amounts)

    def drop(self, key: str) -> T | None:
        """Remove a record and return it, or None if there is none."""
        record = self._forget(key)
        if record is not None:
            self.changed.add(key)
            self._notify(record, None)
        return record

    def removed(self) -> list[Ref]:
        """Return the references of changed records that are gone."""
        return [Ref(self.kind.__name__.lower(), key) for key in self.changed if key not in self]

    def _notify(self, before: T | None, after: T | None) -> None:
        for watcher in self.watchers:
            watcher(before, after)

    def _forget(self, key: str) -> T | None:
        record = self._records.pop(key, None)
        if record is not None:
            amounts = self._amounts(record)
            for term in self._terms(record):
                self._index[term].pop(key)
                if amounts:
                    self._sums[term].subtract(amounts)
                if not self._index[term]:
                    del self._index[term]
                    self._sums.pop(term, None)
        return record


def at(process: str) -> str:
    """Return the index term of records at a process; no user's name begins with @."""
    return f"@{process}"


def all_of(user: str) -> str:
    """Return the index term of a user's connections; no link or interface has a name with a space."""
    return f"user {user}"


def visitors(user: str) -> str:
    """Return the index term of a user's robots that are guests of other users."""
    return f"visitors {user}"


def followers(user: str) -> str:
    """Return the index term of a user's robots that asked for events."""
    return f"followers {user}"


def user_at(user: str, machine: str) -> str:
    """Return the index term of a user's environments on a machine."""
    return f"{user} {at(machine)}"


def pair(one: str, other: str) -> str:
    """Return the index term of the links between two processes, in any order."""
    return " ".join(sorted((one, other)))


def amounts(environment: Environment) -> dict[str, float]:
    """Return what an environment takes: slots and GPUs, cores, bytes of memory, bytes a second."""
    options = environment.options
    return {
        "size": options.size,
        "gpus": options.gpus,
        "cores": cores(options),
        "memory": memory(options),
        "bandwidth": options.bandwidth,
    }


def cores(options: EnvironmentOptions) -> float:
    """Return the cores of an environment."""
    return options.cpu or options.size * slots.CORES


def memory(options: EnvironmentOptions) -> int:
    """Return the bytes of memory of an environment."""
    return options.memory or options.size * slots.MEMORY


def _terms_of_environment(environment: Environment) -> set[str]:
    user = user_of(environment.name)
    return {user, at(environment.machine), user_at(user, environment.machine)}


def _terms_of_robot(robot: Robot) -> set[str]:
    user = user_of(robot.name)
    visits = {visitors(user)} if robot.by.user != user else set()
    follows = {followers(user)} if robot.events else set()
    return {user, at(robot.endpoint)} | visits | follows


def _terms_of_link(link: Link) -> set[str]:
    return {link.listener, link.dialler, pair(link.listener, link.dialler)}


class State:
    """All records, and which processes are connected. Each network group gets a subnet of `group_pool`."""

    def __init__(self) -> None:
        self.group_pool = GROUP_POOL
        self.environments = Table(Environment, _terms_of_environment, amounts)
        self.robots = Table(Robot, _terms_of_robot)
        self.nodes = Table(Node, lambda record: (record.owner,))
        self.ends = Table(NodeEnd, lambda record: (record.owner,))
        self.parameters = Table(Parameter, lambda record: (record.owner,))
        self.recorders = Table(Recorder, lambda record: (record.owner,))
        self.interfaces = Table(Interface, lambda record: (record.owner,))
        self.connections = Table(
            Connection,
            lambda record: {record.sender, record.receiver, record.link, all_of(record.user)} - {""},
        )
        self.waiting = Table(
            Waiting, lambda record: {record.sender, record.receiver, record.by, all_of(user_of(record.sender))} - {""}
        )
        self.processes = Table(Process, lambda record: (record.role,))
        self.links = Table(Link, _terms_of_link)
        self.packages = Table(Package, lambda record: {user_of(record.name), *(f">{user}" for user in record.shared)})
        self.offers = Table(Offer, lambda record: {user_of(record.name), *(f">{user}" for user in record.shared)})
        self.instances = Table(Instance, lambda record: (record.offer,))
        self.uses = Table(Use, lambda record: {record.robot, record.environment, record.offer})
        self.tallies = Table(Tally, lambda record: {record.offer, record.user})
        self.secrets = Table(Secret, lambda record: (user_of(record.name),))
        self.joined: set[str] = set()  # processes with a control connection
        self.expected: set[str] = set()  # processes that lost it, within their grace period
        self.away: set[str] = set()  # robots without a socket, within their grace period
        self.removed_machines: dict[str, float] = {}  # when machines were removed, in seconds since 1970
        self.removed_users: dict[str, float] = {}  # when users were removed

    def tables(self) -> list[Table[Any]]:
        """Return all tables, in the order of their dependencies."""
        return [
            self.environments,
            self.robots,
            self.nodes,
            self.ends,
            self.parameters,
            self.recorders,
            self.interfaces,
            self.connections,
            self.waiting,
            self.processes,
            self.links,
            self.packages,
            self.offers,
            self.instances,
            self.uses,
            self.tallies,
            self.secrets,
        ]

    def robots_of_user(self, user: str) -> int:
        """Count a user's robots without other users' guests."""
        return self.robots.count(user) - self.robots.count(visitors(user))

    def connections_of_user(self, user: str) -> int:
        """Count a user's connections without those of other users' guests."""
        names = [robot.name for robot in self.robots.by(visitors(user))]
        interfaces = [interface.key for name in names for interface in self.interfaces.by(name)]
        of_visitors = {connection.key for key in interfaces for connection in self.connections.by(key)}
        return self.connections.count(all_of(user)) - len(of_visitors)

    def visits(self, owner: str) -> bool:
        """Return whether a robot is a guest of another user, which counts in none of the owner's limits."""
        robot = self.robots.get(owner)
        return robot is not None and robot.by.user != user_of(owner)

    def gone(self, process: str) -> bool:
        """Return whether a process is absent and its grace period is over."""
        return process not in self.joined and process not in self.expected

    def forget(self, process: str) -> None:
        """Remove a process, connected or not."""
        self.processes.drop(process)
        self.joined.discard(process)
        self.expected.discard(process)

    def host(self, owner: str) -> str:
        """Return the endpoint process of a robot or environment if it is connected, else an empty string."""
        robot = self.robots.get(owner)
        process = robot.endpoint if robot else owner
        return process if process in self.joined else ""
