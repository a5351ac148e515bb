"""View cache: the views of all records, kept up to date while somebody watches.

Changes mark views as stale; `take` renews the stale ones in one go.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args

import msgspec
from msgspec import Raw

from master.execution.readiness import Readiness
from master.graph.records import (
    Connection,
    Environment,
    Interface,
    Node,
    Parameter,
    Process,
    Record,
    Recorder,
    Ref,
    Robot,
)
from master.graph.state import at
from master.live.presenter import Presenter
from rce.api.views import Kind

KINDS: tuple[Kind, ...] = get_args(Kind)
KIND_OF: dict[str, Kind] = {
    "robot": "robots",
    "environment": "environments",
    "node": "nodes",
    "parameter": "parameters",
    "recorder": "recorders",
    "interface": "interfaces",
    "connection": "connections",
    "process": "machines",
}
Views = dict[Kind, dict[str, Raw]]


class ViewCache:
    """Views as JSON, by kind and key as in Deltas. They are current except for `marked` ones; none while closed."""

    def __init__(self, presenter: Presenter, readiness: Readiness) -> None:
        self.views: Views = {}
        self.marked: dict[Kind, set[str]] = {kind: set() for kind in KINDS}
        self._presenter = presenter
        self._state = state = presenter.state
        self._tables = {
            KIND_OF[kind]: table for table in state.tables() if (kind := table.kind.__name__.lower()) in KIND_OF
        }
        for table in self._tables.values():
            table.watchers.append(self._changed)
        readiness.observers.append(self._ready)

    def open(self) -> None:
        """Make all views; from now on they are kept up to date."""
        self.views = {
            kind: {key: view for key in self._keys(kind) if (view := self._make(kind, key))} for kind in KINDS
        }

    def close(self) -> None:
        """Drop all views."""
        self.views = {}
        for marked in self.marked.values():
            marked.clear()

    def take(self) -> tuple[Views, dict[Kind, list[str]]]:
        """Renew marked views; return those that changed, and the keys of those that are gone."""
        put: Views = {}
        drop: dict[Kind, list[str]] = {}
        for kind, marked in self.marked.items():
            present = self.views[kind]
            for key in marked:
                view = self._make(kind, key)
                if view is None:
                    if present.pop(key, None) is not None:
                        drop.setdefault(kind, []).append(key)
                elif bytes(view) != bytes(present.get(key, b"")):
                    present[key] = view
                    put.setdefault(kind, {})[key] = view
            marked.clear()
        return put, drop

    # --- marks --------------------------------------------------------------------------------------------------------

    def mark(self, kind: Kind, key: str) -> None:
        """Mark a view as stale."""
        if self.views:
            self.marked[kind].add(key)

    def process_moved(self, name: str) -> None:
        """Mark the views that show whether a process is connected."""
        self.mark("machines", name)
        self.mark("environments", name)
        for robot in self._state.robots.by(at(name)):
            self.mark("robots", robot.name)

    def _ready(self, ref: Ref) -> None:
        if ref.kind in KIND_OF:
            self.mark(KIND_OF[ref.kind], ref.key)

    def _changed(self, before: Record | None, after: Record | None) -> None:
        for record in (before, after):
            if record is not None and self.views:
                self.mark(KIND_OF[type(record).__name__.lower()], record.key)
                self._mark_around(record, before is None or after is None)

    def _mark_around(self, record: Record, new: bool) -> None:
        """Mark other views that show something of a record; `new`: it was added or removed."""
        match record:
            case Environment():
                self.mark("machines", record.machine)
                self.mark("groups", f"{record.name.partition('/')[0]}/{record.options.group}")
            case Robot():
                self.mark("machines", record.endpoint)
            case Node() | Parameter() | Recorder() if new:
                self.mark("environments", record.owner)
            case Interface() if new:
                self.mark("environments", record.owner)
                self.mark("robots", record.owner)
            case Connection() if new:
                self.mark("interfaces", record.sender)
                self.mark("interfaces", record.receiver)
            case Process():
                self.mark("environments", record.name)

    # --- views --------------------------------------------------------------------------------------------------------

    def _keys(self, kind: Kind) -> Iterator[str]:
        if kind == "groups":
            for environment in self._state.environments:
                if environment.options.group:
                    yield f"{environment.name.partition('/')[0]}/{environment.options.group}"
        else:
            for record in self._tables[kind]:
                yield record.key

    def _make(self, kind: Kind, key: str) -> Raw | None:
        """Make a view, or return None if there is no such record."""
        view: Any = None
        if kind == "groups":
            user, _, group = key.partition("/")
            view = next((each for each in self._presenter.groups(user) if each.group == group), None)
        elif (record := self._tables[kind].get(key)) is not None and getattr(record, "role", "") != "environment":
            view = getattr(self._presenter, type(record).__name__.lower())(record)
        return None if view is None else Raw(msgspec.json.encode(view))
