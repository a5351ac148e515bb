"""How long messages stay in this process, and single messages followed through it.

A message knows when it came into the process (`Message.since`). Towards a link, what is measured is conversion and
waiting; towards a robot or ROS, these and writing.

Messages of interfaces that somebody follows are noted besides: the hops of one message in several processes are joined
by its id (`rce trace`).
"""

from __future__ import annotations

import asyncio
import time
from collections import defaultdict, deque

from msgspec.structs import replace

from endpoints.frames import Message
from rce.calls.watching import FollowMessages, Hop, Passage, Passages
from rce.metrics import QUICK, Timing

MOST = 4000  # passages of one trace that wait to be fetched: the newest
_stays = Timing("rce_hop_seconds", "Time that messages spend in the process, by where they go", "hop", bounds=QUICK)


class _Trace:
    """`noted` has times of `time.perf_counter`."""

    def __init__(self, interfaces: set[bytes]) -> None:
        self.interfaces = interfaces
        self.noted: deque[Passage] = deque(maxlen=MOST)
        self.expiry: asyncio.TimerHandle | None = None


class Watch:
    """All hops of one endpoint. The thread of ROS calls `ended` only."""

    def __init__(self) -> None:
        self._to_link, self._from_link = _stays.of("to_link"), _stays.of("from_link")
        self._traces: dict[str, _Trace] = {}
        self._followed: dict[bytes, list[_Trace]] = {}  # by interface; empty while nobody follows

    def left(self, message: Message) -> None:
        """It begins to go out over a link."""
        self._to_link.since(message.since)
        if message.source in self._followed:
            self._note(message.source, message, "entered", message.since)
            self._note(message.source, message, "sent", time.perf_counter())

    def came(self, interface: bytes, message: Message) -> None:
        """It has come in over a link, for this interface."""
        if interface in self._followed:
            self._note(interface, message, "received", time.perf_counter())

    def ended(self, interface: bytes, message: Message) -> None:
        """What came over a link has gone out to the robot, or to ROS."""
        self._from_link.since(message.since)
        if interface in self._followed:
            self._note(interface, message, "delivered", time.perf_counter())

    def _note(self, interface: bytes, message: Message, hop: Hop, at: float) -> None:
        who = message.destination or message.source  # of an answer to a request: who asked
        for trace in self._followed.get(interface, ()):
            trace.noted.append(Passage(who.hex(), message.msg_id, interface.hex(), hop, at))

    # --- for who follows ----------------------------------------------------------------------------------------------

    async def follow(self, call: FollowMessages) -> Passages:
        """What was noted since the call before."""
        trace = self._traces.setdefault(call.trace, _Trace(set()))
        if trace.expiry is not None:
            trace.expiry.cancel()
        trace.expiry = asyncio.get_running_loop().call_later(call.seconds, self._forget, call.trace)
        trace.interfaces = {bytes.fromhex(id) for id in call.interfaces}
        self._attend()
        offset = time.time() - time.perf_counter()
        noted = [trace.noted.popleft() for _ in range(len(trace.noted))]
        return Passages([replace(each, time=each.time + offset) for each in noted])

    def _forget(self, name: str) -> None:
        del self._traces[name]
        self._attend()

    def _attend(self) -> None:
        followed: dict[bytes, list[_Trace]] = defaultdict(list)
        for trace in self._traces.values():
            for interface in trace.interfaces:
                followed[interface].append(trace)
        self._followed = dict(followed)
