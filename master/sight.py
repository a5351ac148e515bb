"""All views of the graph, kept up while somebody looks: changes mark views, and what is marked is made anew at once."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args

import msgspec
from msgspec import Raw

from master.carrier import Carrier
from master.records import Connection, Environment, Interface, Node, Parameter, Process, Record, Robot, at
from master.shown import Shown
from rce.views import Kind

KINDS: tuple[Kind, ...] = get_args(Kind)
KIND_OF: dict[str, Kind] = {
    "Robot": "robots",
    "Environment": "environments",
    "Node": "nodes",
    "Parameter": "parameters",
    "Interface": "interfaces",
    "Connection": "connections",
    "Process": "machines",
}
Views = dict[Kind, dict[str, Raw]]


class Sight:
    """`views` are those of now, as JSON, but for what is `marked`; empty while it is closed. Keys as in Deltas."""

    def __init__(self, shown: Shown, carrier: Carrier) -> None:
        self.views: Views = {}
        self.marked: dict[Kind, set[str]] = {kind: set() for kind in KINDS}
        self._shown = shown
        self._state = state = shown.state
        self._tables = {
            KIND_OF[table.kind.__name__]: table for table in state.tables() if table.kind.__name__ in KIND_OF
        }
        for table in self._tables.values():
            table.watchers.append(self._changed)
        carrier.watchers.append(self._real)

    def open(self) -> None:
        self.views = {
            kind: {key: view for key in self._keys(kind) if (view := self._make(kind, key))} for kind in KINDS
        }

    def close(self) -> None:
        self.views = {}
        for marked in self.marked.values():
            marked.clear()

    def take(self) -> tuple[Views, dict[Kind, list[str]]]:
        """Make anew what is marked: the views that came out different, and the keys of those that are gone."""
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

    # --- what marks views ---------------------------------------------------------------------------------------------

    def mark(self, kind: Kind, key: str) -> None:
        if self.views:
            self.marked[kind].add(key)

    def process_moved(self, name: str) -> None:
        """A process came or went."""
        self.mark("machines", name)
        self.mark("environments", name)
        for robot in self._state.robots.by(at(name)):
            self.mark("robots", robot.name)

    def _real(self, what: str) -> None:
        kind, _, key = what.partition(" ")
        if kind in KIND_OF:
            self.mark(KIND_OF[kind], key)

    def _changed(self, before: Record | None, after: Record | None) -> None:
        for record in (before, after):
            if record is not None and self.views:
                self.mark(KIND_OF[type(record).__name__], record.key)
                self._mark_around(record, before is None or after is None)

    def _mark_around(self, record: Record, new: bool) -> None:
        """Views that tell of a record besides its own; `new`: or it is gone."""
        match record:
            case Environment():
                self.mark("machines", record.machine)
                self.mark("groups", f"{record.name.partition('/')[0]}/{record.options.group}")
            case Robot():
                self.mark("machines", record.endpoint)
            case Node() | Parameter() if new:
                self.mark("environments", record.owner)
            case Interface() if new:
                self.mark("environments", record.spec.owner)
                self.mark("robots", record.spec.owner)
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
        """None if there is no such thing."""
        view: Any = None
        if kind == "groups":
            user, _, group = key.partition("/")
            view = next((each for each in self._shown.groups(user) if each.group == group), None)
        elif (record := self._tables[kind].get(key)) is not None and getattr(record, "role", "") != "environment":
            view = getattr(self._shown, type(record).__name__.lower())(record)
        return None if view is None else Raw(msgspec.json.encode(view))
