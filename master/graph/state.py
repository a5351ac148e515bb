"""State of the graph: tables of all records, and which processes are connected."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from ipaddress import IPv4Network
from typing import Any, Generic, TypeVar

from master.graph.records import (
    Connection,
    Environment,
    Interface,
    Link,
    Node,
    Package,
    Parameter,
    Process,
    Record,
    Ref,
    Robot,
    Waiting,
    user_of,
)

GROUP_POOL = IPv4Network("10.128.0.0/10")  # the upper half of 10/8 is seldom used; 16384 groups

T = TypeVar("T", bound=Record)


class Table(Generic[T]):
    """Records of one kind, indexed by key and by the terms that `terms` returns for a record.

    `changed` collects keys for the store. Each of `watchers` is called with the record before and after a change.
    """

    def __init__(self, kind: type[T], terms: Callable[[T], Iterable[str]]) -> None:
        self.kind = kind
        self.changed: set[str] = set()
        self.watchers: list[Callable[[T | None, T | None], None]] = []
        self._records: dict[str, T] = {}
        self._terms = terms
        self._index: dict[str, dict[str, None]] = {}  # a dict as an ordered set keeps the order of effects fixed

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
        for term in self._terms(record):
            self._index.setdefault(term, {})[record.key] = None

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
            for term in self._terms(record):
                self._index[term].pop(key)
                if not self._index[term]:
                    del self._index[term]
        return record


def at(process: str) -> str:
    """Return the index term of records at a process; no user's name begins with @."""
    return f"@{process}"


def all_of(user: str) -> str:
    """Return the index term of a user's connections; no link or interface has a name with a space."""
    return f"user {user}"


class State:
    """All records, and which processes are connected. Each network group gets a subnet of `group_pool`."""

    def __init__(self) -> None:
        self.group_pool = GROUP_POOL
        self.environments = Table(Environment, lambda record: {user_of(record.name), at(record.machine)})
        self.robots = Table(Robot, lambda record: {user_of(record.name), at(record.endpoint)})
        self.nodes = Table(Node, lambda record: (record.owner,))
        self.parameters = Table(Parameter, lambda record: (record.owner,))
        self.interfaces = Table(Interface, lambda record: (record.owner,))
        self.connections = Table(
            Connection,
            lambda record: {record.sender, record.receiver, record.link, all_of(user_of(record.sender))} - {""},
        )
        self.waiting = Table(
            Waiting, lambda record: {record.sender, record.receiver, record.by, all_of(user_of(record.sender))} - {""}
        )
        self.processes = Table(Process, lambda record: (record.role,))
        self.links = Table(Link, lambda record: {record.listener, record.dialler})
        self.packages = Table(Package, lambda record: {user_of(record.name), *(f">{user}" for user in record.shared)})
        self.joined: set[str] = set()  # processes with a control connection
        self.expected: set[str] = set()  # processes that lost it, within their grace period
        self.away: set[str] = set()  # robots without a socket, within their grace period

    def tables(self) -> list[Table[Any]]:
        """Return all tables, in the order of their dependencies."""
        return [
            self.environments,
            self.robots,
            self.nodes,
            self.parameters,
            self.interfaces,
            self.connections,
            self.waiting,
            self.processes,
            self.links,
            self.packages,
        ]

    def robots_of_user(self, user: str) -> int:
        """Count a user's robots without other users' guests."""
        return sum(not self.visits(robot.name) for robot in self.robots.by(user))

    def connections_of_user(self, user: str) -> int:
        """Count a user's connections without those of other users' guests."""
        visitors = [robot.name for robot in self.robots.by(user) if self.visits(robot.name)]
        interfaces = [interface.key for name in visitors for interface in self.interfaces.by(name)]
        of_visitors = {connection.key for key in interfaces for connection in self.connections.by(key)}
        return len(self.connections.by(all_of(user))) - len(of_visitors)

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
