"""What happened on the platform, for those who follow it. The newest are kept, so that one who was away, or does not
read, takes up where it ended; who is too late for that hears that something was missed."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import AsyncIterator
from typing import Any

from master.records import Connection, Environment, Process, Record, Robot, State, user_of
from rce import messages as m
from rce.views import Event
from rce.views.live import EventType

KEPT = 10_000


class Events:
    """Events by their numbers. Their ids name this life of the Master too: the next one begins to count anew."""

    def __init__(self, state: State) -> None:
        self._life = secrets.token_hex(4)
        self._kept: dict[int, Event] = {}
        self._next = 1
        self._news = asyncio.Event()
        for table in (state.robots, state.environments, state.connections):
            watchers: list[Any] = table.watchers
            watchers.append(self._changed)

    def position(self, id: str) -> int:
        """Where one goes on who had the event `id` last; an empty id is the end."""
        life, _, number = id.partition("-")
        if not id:
            return self._next
        return int(number) + 1 if life == self._life and number.isdecimal() else 0

    async def follow(self, position: int) -> AsyncIterator[Event]:
        """The events from there on, for ever."""
        while True:
            news = self._news
            oldest = self._next - len(self._kept)
            if position < oldest or position > self._next:
                yield self._event(oldest - 1, "missed", "", "", text="events before this are not kept any more")
                position = oldest
            while (event := self._kept.get(position)) is not None:
                position += 1
                yield event
            if position >= self._next:
                await news.wait()

    # --- what happens -------------------------------------------------------------------------------------------------

    def told(self, user: str, status: m.StatusData) -> None:
        """What robots of a user are told."""
        match status:
            case m.EnvironmentEvent(tag, "ready"):
                self._add("environment.ready", user, f"{user}/{tag}")
            case m.EnvironmentEvent(tag, state, reason):
                self._add(
                    "environment.failed" if state == "failed" else "environment.lost", user, f"{user}/{tag}", reason
                )
            case m.NodeEvent(tag, node, code, lines):
                text = f"ended with status {code}"
                self._add("node.died", user, f"{user}/{tag}/{node}", text, status=code, lines=lines)
            case m.LimitEvent(reason):
                self._add("limit.reached", user, user, reason)

    def process_moved(self, process: Process, here: bool) -> None:
        """A process joined or left."""
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

    def _add(self, type: EventType, user: str, object: str, text: str = "", **more: Any) -> None:
        self._kept[self._next] = self._event(self._next, type, user, object, text=text, **more)
        self._kept.pop(self._next - KEPT, None)
        self._next += 1
        news, self._news = self._news, asyncio.Event()
        news.set()

    def _event(self, number: int, type: EventType, user: str, object: str, **more: Any) -> Event:
        return Event(f"{self._life}-{number}", time.time(), type, user, object, **more)
