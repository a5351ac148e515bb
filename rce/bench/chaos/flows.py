"""Numbered messages that flow all the time, so that losses, duplicates and changes of order are counted."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from itertools import pairwise
from typing import Any

from msgspec import Struct

from rce.client import Environment, Publisher, Robot, Subscriber
from rce.errors import TimedOut
from rce.protocol.messages import DropEvent, Qos

STRING = "std_msgs/String"
PACKAGE, NODE = "rce_bench", "numbered"
TOPIC = "/numbers"
PERIOD = 0.05  # seconds between messages
KEEP = 1000  # messages that may wait in each queue
# volatile: else a node that is started again gets the last message once more, as every late node does
DEEP = Qos(reliability="reliable", durability="volatile", depth=KEEP)
POLL_INTERVAL = 0.01  # seconds
AFTER = 1.0  # seconds after a fault in which messages may still be sent to the process that failed
START_TIMEOUT = 60.0  # seconds until the first message of a flow has arrived
SETTLED = 15.0  # seconds after which a message that has not arrived is lost


class FlowCount(Struct, frozen=True):
    """Messages of a flow.

    Attributes:
        name: Name of the flow.
        sent: Messages that the client library took.
        received: Messages that arrived.
        lost_in_faults: Lost ones that a process may have had in its memory when it was killed.
        lost: All other lost ones.
        reported: Drops that the platform and the client library reported.
        duplicates: Messages that arrived again.
        reordered: Messages that arrived after a later one.
    """

    name: str
    sent: int
    received: int
    lost_in_faults: int
    lost: int
    reported: int
    duplicates: int
    reordered: int

    def problems(self) -> list[str]:
        """Return what must not be."""
        found = []
        if self.duplicates:
            found.append(f"{self.duplicates} messages arrived twice")
        if self.reordered:
            found.append(f"{self.reordered} messages arrived after later ones")
        if self.lost > self.reported:
            found.append(f"{self.lost} messages were lost without a reason, {self.reported} drops were reported")
        return [f"flow {self.name}: {each}" for each in found]


class Flow:
    """Numbered messages from a publisher to a subscriber, one each PERIOD."""

    def __init__(self, name: str) -> None:
        """Create a flow without messages.

        Args:
            name: Name of the flow.
        """
        self.name = name
        self._sent: dict[int, float] = {}
        self._received: dict[int, float] = {}
        self._duplicates = self._reordered = self._declined = self._drops = 0
        self._newest = -1
        self._disturbed: list[tuple[int, float]] = []  # newest number that had arrived before, and end
        self._reported: dict[tuple[str, str], int] = {}
        self._task: asyncio.Task[None] | None = None
        self._publisher: Publisher | None = None
        self._subscriber: Subscriber | None = None

    def begin(self, publisher: Publisher, subscriber: Subscriber) -> None:
        """Send until `end`; `subscriber` must call `receive`."""
        self._publisher, self._subscriber = publisher, subscriber
        self._task = asyncio.create_task(self._send(publisher))

    async def end(self) -> None:
        """Send nothing more, and wait until the last message has arrived or counts as lost."""
        if self._task is None:
            return
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        if self._sent:
            with suppress(TimedOut):  # `count` reports it
                await self.wait_for_message(max(self._sent.values()), SETTLED)

    def receive(self, message: dict[str, Any]) -> None:
        """Take in a message that arrived."""
        number = int(message["data"])
        if number in self._received:
            self._duplicates += 1
            return
        self._reordered += number < self._newest
        self._newest = max(number, self._newest)
        self._received[number] = time.monotonic()

    def report(self, event: DropEvent) -> None:
        """Take in a report of drops, whose count grows for as long as the interface lives."""
        before = self._reported.get((event.iTag, event.where), 0)
        self._drops += event.count - before if event.count >= before else event.count
        self._reported[event.iTag, event.where] = event.count

    def disturb(self, since: float, until: float) -> None:
        """Permit the loss of messages that were under way in a period, by the monotonic clock.

        Messages keep their order, so those after the newest one that had arrived were under way.
        """
        newest = max((number for number, at in self._received.items() if at < since), default=-1)
        self._disturbed.append((newest, until + AFTER))

    async def wait_for_message(self, since: float, seconds: float) -> None:
        """Wait until a message that was sent at a time or later has arrived.

        Raises:
            TimedOut: None has.
        """
        until = time.monotonic() + seconds
        while not any(self._sent[number] >= since for number in self._latest()):
            if time.monotonic() > until:
                raise TimedOut(f"no message of flow {self.name} arrived for {seconds:g} s")
            await asyncio.sleep(POLL_INTERVAL)

    def forget_earlier(self) -> None:
        """Do not count messages that were sent before the newest one that has arrived."""
        self._sent = {number: at for number, at in self._sent.items() if number >= self._newest}

    def _latest(self) -> list[int]:
        return [self._newest] if self._newest in self._received else []

    def count(self) -> FlowCount:
        """Count what was sent until SETTLED seconds ago, or all if nothing more is sent."""
        lost, in_faults = self.lost()
        own = self._publisher.dropped - self._declined if self._publisher is not None else 0
        own += self._subscriber.dropped if self._subscriber is not None else 0
        return FlowCount(
            self.name,
            len(self._sent),
            len(self._received),
            len(in_faults),
            len(lost),
            self._drops + own,
            self._duplicates,
            self._reordered,
        )

    def lost(self) -> tuple[list[int], list[int]]:
        """Return the numbers of lost messages, and of those that a process may have had in its memory in a fault."""
        settled = time.monotonic() - (SETTLED if self._task is not None and not self._task.done() else 0.0)
        lost: tuple[list[int], list[int]] = [], []
        for number, at in self._sent.items():
            if at < settled and number not in self._received:
                lost[any(number > newest and at <= until for newest, until in self._disturbed)].append(number)
        return lost

    def longest_gap(self) -> float:
        """Return the longest time in seconds between the arrivals of two messages."""
        at = sorted(self._received.values())
        return max((later - earlier for earlier, later in pairwise(at)), default=0.0)

    async def _send(self, publisher: Publisher) -> None:
        number = 0
        while True:
            at = time.monotonic()
            if publisher.offer({"data": str(number)}, keep=KEEP):
                self._sent[number] = at
            else:
                self._declined += 1
            number += 1
            await asyncio.sleep(PERIOD)


async def through_node(robot: Robot, environment: Environment) -> Flow:
    """Begin a flow from a robot to a node in its environment and back.

    What is sent before the first message comes back does not count: the node may send a message back before DDS
    discovery has finished.

    Raises:
        TimedOut: No message comes back.
    """
    flow = Flow(f"{robot.name} to {environment.tag} and back")
    await environment.add_node(NODE, PACKAGE, NODE)
    subscriber = await environment.subscriber(f"{TOPIC}_back", STRING, callback=flow.receive, depth=KEEP, qos=DEEP)
    flow.begin(await environment.publisher(TOPIC, STRING, qos=DEEP), subscriber)
    await flow.wait_for_message(0.0, START_TIMEOUT)
    flow.forget_earlier()
    return flow


async def between(one: Robot, other: Robot) -> Flow:
    """Begin a flow from a robot to another."""
    flow = Flow(f"{one.name} to {other.name}")
    publisher = await one.publisher("say", STRING, qos=DEEP)
    subscriber = await other.subscriber(
        "hear", STRING, to=f"{one.name}/say", callback=flow.receive, depth=KEEP, qos=DEEP
    )
    flow.begin(publisher, subscriber)
    return flow
