"""Live feed: a snapshot of the graph for each watcher, then changes, at most ten times a second.

Nothing is done while nobody watches.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

import msgspec

from master.live.gauges import Changed
from master.live.view_cache import ViewCache
from rce.api.views import Deltas, Kind

PAUSE = 0.1  # seconds between messages


class Watcher(Protocol):
    """Receiver of the feed."""

    @property
    def free(self) -> bool:
        """Return whether it can take more. If not, it gets a new snapshot later (`Feed.catch_up`)."""

    def sees(self, kind: Kind, key: str, gone: bool = False) -> bool:
        """Return whether it may see a view; `gone`: whether it saw the view."""

    def send(self, message: bytes) -> None:
        """Send Deltas in JSON."""


class Feed:
    """Sends watchers what changed in the view cache.

    `measure` starts measuring rates and usage, calls back with the keys of changed ones, and returns a function that
    stops it.
    """

    def __init__(
        self, view_cache: ViewCache, measure: Callable[[Callable[[Changed], None]], Callable[[], None]]
    ) -> None:
        self.view_cache = view_cache
        self._measure = measure
        self._stop_measuring: Callable[[], None] = lambda: None  # stops measuring
        self._sent: dict[Watcher, int] = {}  # messages so far
        self._behind: set[Watcher] = set()
        self._timer: asyncio.TimerHandle | None = None

    @property
    def watched(self) -> bool:
        """True if there is a watcher."""
        return bool(self._sent)

    def add(self, watcher: Watcher) -> None:
        """Add a watcher and send it a snapshot."""
        if not self._sent:
            self.view_cache.open()
            self._timer = asyncio.get_running_loop().call_later(PAUSE, self._tick)
            self._stop_measuring = self._measure(self._measured)
        self._sent[watcher] = 0
        self._snapshot(watcher)

    def remove(self, watcher: Watcher) -> None:
        """Remove a watcher."""
        if self._sent.pop(watcher, None) is None:
            return
        self._behind.discard(watcher)
        if not self._sent:
            self.view_cache.close()
            if self._timer is not None:
                self._timer.cancel()
            self._stop_measuring()

    def catch_up(self, watcher: Watcher) -> None:
        """Send a snapshot to a watcher that can take more again, if it missed changes."""
        if watcher in self._behind:
            self._behind.discard(watcher)
            self._snapshot(watcher)

    def _measured(self, changed: Changed) -> None:
        for kind, keys in changed.items():
            for key in keys:
                self.view_cache.mark(kind, key)

    def _tick(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(PAUSE, self._tick)
        if not any(self.view_cache.marked.values()):
            return
        put, drop = self.view_cache.take()
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
                put=_visible(put, watcher),
                drop={
                    kind: seen
                    for kind, keys in drop.items()
                    if (seen := [key for key in keys if watcher.sees(kind, key, gone=True)])
                },
            )
            if deltas.put or deltas.drop:
                self._send(watcher, deltas)

    def _snapshot(self, watcher: Watcher) -> None:
        self._send(watcher, Deltas(0, True, _visible(self.view_cache.views, watcher)))

    def _send(self, watcher: Watcher, deltas: Deltas) -> None:
        self._sent[watcher] += 1
        watcher.send(msgspec.json.encode(msgspec.structs.replace(deltas, seq=self._sent[watcher])))


def _visible(views: Any, watcher: Watcher) -> dict[Kind, dict[str, Any]]:
    """Return the views that the watcher sees, by kind."""
    found = {kind: {key: view for key, view in each.items() if watcher.sees(kind, key)} for kind, each in views.items()}
    return {kind: each for kind, each in found.items() if each}
