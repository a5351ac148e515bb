"""Events of the platform for followers.

The newest are kept, so that a follower that was away or slow continues where it stopped. One that is too late for that
gets an event `missed`. They are kept as msgpack, which takes a third of the memory of the objects.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections import Counter, deque
from collections.abc import AsyncIterator, Sequence
from typing import Any

import msgspec

from master.graph.records import Connection, Environment, Interface, Process, Record, Robot, user_of
from master.graph.state import State
from rce.api.knowledge import Action
from rce.api.views import Event
from rce.api.views.live import EventType
from rce.control.calls.knowledge import NotedChange
from rce.protocol import messages as m

MAX_EVENTS = 10_000
MAX_SIZE = 16 * 1024 * 1024  # bytes of all kept events
MANY_CHANGES = 50  # of the knowledge repository that are told one by one, if they come at once
KNOWLEDGE: dict[Action, EventType] = {
    "added": "knowledge.added",
    "changed": "knowledge.changed",
    "removed": "knowledge.removed",
}
MAX_LINES = 4000  # characters of the output of a node in one event

_decoder = msgspec.msgpack.Decoder(Event)


class Events:
    """Events by number. Their ids contain one of this life of the Master, because the next life counts anew."""

    def __init__(self, state: State) -> None:
        self._life = secrets.token_hex(4)
        self._kept: deque[bytes] = deque()  # the last one has the number before `_next`
        self._next = 1
        self._size = 0
        self._news = asyncio.Event()
        self._robots = state.robots
        for table in (state.robots, state.environments, state.connections, state.interfaces):
            watchers: list[Any] = table.watchers
            watchers.append(self._changed)

    def position(self, id: str) -> int:
        """Return the position after the event `id`; an empty id is the end."""
        life, _, number = id.partition("-")
        if not id:
            return self._next
        return int(number) + 1 if life == self._life and number.isdecimal() else 0

    @property
    def _oldest(self) -> int:
        return self._next - len(self._kept)

    async def follow(self, position: int) -> AsyncIterator[Event]:
        """Yield the events from a position on, and new ones as they happen."""
        while True:
            news = self._news
            if position < self._oldest or position > self._next:
                oldest = self._oldest
                yield self._event(oldest - 1, "missed", "", "", text="events before this are not kept any more")
                position = oldest
            while self._oldest <= position < self._next:
                position += 1
                yield _decoder.decode(self._kept[position - 1 - self._oldest])
            if position >= self._next:
                await news.wait()

    # --- sources ------------------------------------------------------------------------------------------------------

    def status_sent(self, user: str, status: m.StatusData) -> None:
        """Add the event for a status that was sent to the robots of a user."""
        match status:
            case m.EnvironmentEvent(tag, "ready"):
                self._add("environment.ready", user, f"{user}/{tag}")
            case m.EnvironmentEvent(tag, state, reason):
                self._add(
                    "environment.failed" if state == "failed" else "environment.lost", user, f"{user}/{tag}", reason
                )
            case m.NodeEvent(tag, node, code, lines):
                text = f"ended with status {code}"
                self._add("node.died", user, f"{user}/{tag}/{node}", text, status=code, lines=_newest(lines))
            case m.RecorderEvent(tag, recorder, reason):
                self._add("recorder.ended", user, f"{user}/{tag}/{recorder}", reason)
            case m.LimitEvent(reason):
                self._add("limit.reached", user, user, reason)

    def knowledge_changed(self, changes: Sequence[NotedChange]) -> None:
        """Add the events for changes of entries of the knowledge repository."""
        if len(changes) > MANY_CHANGES:
            counts = Counter((change.author, change.public) for change in changes)
            for (author, public), count in counts.items():
                self._add("knowledge.changed", author, author, f"{count} changes of entries", public=public)
            return
        for change in changes:
            text = f"by {change.user}" if change.user != change.author else ""
            object = f"{change.author}/{change.kind}/{change.uid}"
            self._add(KNOWLEDGE[change.action], change.author, object, text, public=change.public)

    def process_moved(self, process: Process, here: bool) -> None:
        """Add the event for a process that joined or left."""
        if process.role != "environment":
            self._add("machine.joined" if here else "machine.left", "", process.name)

    def _changed(self, before: Record | None, after: Record | None) -> None:
        record = after or before
        if record is None or (before is not None and after is not None):
            return
        here, user = after is not None, user_of(record.key)
        match record:
            case Robot():
                self._add("robot.came" if here else "robot.left", user, record.key)
            case Connection():
                self._add("connection.made" if here else "connection.gone", user, record.key)
            case Environment() if not here:
                self._add("environment.gone", user, record.key)
            case Interface() if not here and record.by and record.by not in self._robots:
                text = f"robot {record.by.partition('/')[2]}, which added it, has left"
                self._add("interface.gone", user, record.key, text)

    def _add(self, type: EventType, user: str, object: str, text: str = "", **more: Any) -> None:
        event = self._event(self._next, type, user, object, text=text[:MAX_LINES], **more)
        self._kept.append(msgspec.msgpack.encode(event))
        self._next += 1
        self._size += len(self._kept[-1])
        while len(self._kept) > MAX_EVENTS or self._size > MAX_SIZE:
            self._size -= len(self._kept.popleft())
        news, self._news = self._news, asyncio.Event()
        news.set()

    def _event(self, number: int, type: EventType, user: str, object: str, **more: Any) -> Event:
        return Event(f"{self._life}-{number}", time.time(), type, user, object, **more)


def _newest(lines: list[str]) -> list[str]:
    """Return the last lines that fit into an event."""
    kept: list[str] = []
    room = MAX_LINES
    for line in reversed(lines):
        room -= len(line) + 1
        if room < 0:
            break
        kept.append(line)
    return kept[::-1]
