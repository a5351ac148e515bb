"""The graph as it changes, for those who watch: all that they may see at first, then what is different, ten times a
second at most. While nobody watches nothing is done.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

import msgspec

from master.gauges import Changed
from master.sight import Sight
from rce.views import Deltas, Kind

PAUSE = 0.1  # seconds for which changes are gathered


class Watcher(Protocol):
    """One who watches."""

    @property
    def free(self) -> bool:
        """Whether there is room for more. One that has none asks for a new snapshot later (`Feed.catch_up`)."""

    def sees(self, kind: Kind, key: str, gone: bool = False) -> bool:
        """Whether this is for them; or was, if it is gone."""

    def send(self, message: bytes) -> None:
        """Deltas, in JSON."""


class Feed:
    """Tells watchers what `sight` finds different. `measure` has rates and usage measured until what it returns is
    called, and tells of which they have changed.
    """

    def __init__(self, sight: Sight, measure: Callable[[Callable[[Changed], None]], Callable[[], None]]) -> None:
        self.sight = sight
        self._measure = measure
        self._leave: Callable[[], None] = lambda: None  # measuring
        self._sent: dict[Watcher, int] = {}  # messages so far
        self._behind: set[Watcher] = set()
        self._timer: asyncio.TimerHandle | None = None

    @property
    def watched(self) -> bool:
        return bool(self._sent)

    def add(self, watcher: Watcher) -> None:
        """Begins with a snapshot."""
        if not self._sent:
            self.sight.open()
            self._timer = asyncio.get_running_loop().call_later(PAUSE, self._tick)
            self._leave = self._measure(self._measured)
        self._sent[watcher] = 0
        self._snapshot(watcher)

    def remove(self, watcher: Watcher) -> None:
        if self._sent.pop(watcher, None) is None:
            return
        self._behind.discard(watcher)
        if not self._sent:
            self.sight.close()
            if self._timer is not None:
                self._timer.cancel()
            self._leave()

    def catch_up(self, watcher: Watcher) -> None:
        """There is room again: what was missed meanwhile comes as a snapshot."""
        if watcher in self._behind:
            self._behind.discard(watcher)
            self._snapshot(watcher)

    def _measured(self, changed: Changed) -> None:
        for kind, keys in changed.items():
            for key in keys:
                self.sight.mark(kind, key)

    def _tick(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(PAUSE, self._tick)
        if not any(self.sight.marked.values()):
            return
        put, drop = self.sight.take()
        if not put and not drop:
            return
        for watcher in self._sent:
            if watcher in self._behind:
                continue
            if not watcher.free:
                self._behind.add(watcher)
                continue
            deltas = Deltas(
                0,
                put=_seen(put, watcher),
                drop={
                    kind: seen
                    for kind, keys in drop.items()
                    if (seen := [key for key in keys if watcher.sees(kind, key)])
                },
            )
            if deltas.put or deltas.drop:
                self._send(watcher, deltas)

    def _snapshot(self, watcher: Watcher) -> None:
        self._send(watcher, Deltas(0, True, _seen(self.sight.views, watcher)))

    def _send(self, watcher: Watcher, deltas: Deltas) -> None:
        self._sent[watcher] += 1
        watcher.send(msgspec.json.encode(msgspec.structs.replace(deltas, seq=self._sent[watcher])))


def _seen(views: Any, watcher: Watcher) -> dict[Kind, dict[str, Any]]:
    """Of the views of each kind those that the watcher sees."""
    found = {kind: {key: view for key, view in each.items() if watcher.sees(kind, key)} for kind, each in views.items()}
    return {kind: each for kind, each in found.items() if each}
