"""Hop times: how long messages stay in this process, and the hops of single messages for `rce trace`.

Each message carries the time at which it came into the process (`Message.entered_at`). For messages to a link, the
histogram covers conversion and queueing; for messages to a robot or to ROS, it covers these and writing.

The hops of an interface's messages are recorded one by one only while somebody follows that interface. The Master
joins the hops of a message in several processes by the message id.
"""

from __future__ import annotations

import asyncio
import time
from collections import defaultdict, deque

from msgspec.structs import replace

from endpoints.data.frames import Message
from rce.control.calls.watching import FollowMessages, Hop, HopRecord, HopRecords
from rce.process.metrics import MESSAGE_BUCKETS, Timing

MAX_RECORDED = 4000  # hops that one trace keeps until they are fetched: the newest
_durations = Timing(
    "rce_hop_seconds", "Time that messages spend in the process, by where they go", "hop", bounds=MESSAGE_BUCKETS
)


class _Trace:
    """Recorded hops of the interfaces that somebody follows; their times are those of `time.perf_counter`."""

    def __init__(self, interfaces: set[bytes]) -> None:
        self.interfaces = interfaces
        self.recorded: deque[HopRecord] = deque(maxlen=MAX_RECORDED)
        self.expiry: asyncio.TimerHandle | None = None


class HopRecorder:
    """Records the hops of all messages of one endpoint."""

    def __init__(self) -> None:
        self._to_link, self._from_link = _durations.labels("to_link"), _durations.labels("from_link")
        self._traces: dict[str, _Trace] = {}
        self._followed: dict[bytes, list[_Trace]] = {}  # by interface; empty while nobody follows

    def sent(self, message: Message) -> None:
        """Record that a message begins to go out over a link."""
        self._to_link.observe(time.perf_counter() - message.entered_at)
        if not self._followed:
            return
        for each in message.by_sender():
            if each.source in self._followed:
                self._record(each.source, each, "entered", each.entered_at)
                self._record(each.source, each, "sent", time.perf_counter())

    def received(self, interface: bytes, message: Message) -> None:
        """Record that a message came in over a link for this interface."""
        if interface in self._followed:
            self._record(interface, message, "received", time.perf_counter())

    def delivered(self, interface: bytes, message: Message) -> None:
        """Record that a message from a link was written to the robot's socket or handed to ROS."""
        self._from_link.observe(time.perf_counter() - message.entered_at)
        if interface in self._followed:
            self._record(interface, message, "delivered", time.perf_counter())

    def _record(self, interface: bytes, message: Message, hop: Hop, at: float) -> None:
        # A response belongs to the trace of its request, which is named by the interface that sent the request.
        origin = message.destination or message.source
        for trace in self._followed.get(interface, ()):
            trace.recorded.append(HopRecord(origin.hex(), message.msg_id, interface.hex(), hop, at))

    # --- the Master's call --------------------------------------------------------------------------------------------

    async def follow(self, call: FollowMessages) -> HopRecords:
        """Start or continue a trace; return the hops recorded since its previous call, with times of day.

        The trace ends when no further call comes within `call.seconds`.
        """
        trace = self._traces.setdefault(call.trace, _Trace(set()))
        if trace.expiry is not None:
            trace.expiry.cancel()
        trace.expiry = asyncio.get_running_loop().call_later(call.seconds, self._expire, call.trace)
        trace.interfaces = {bytes.fromhex(id) for id in call.interfaces}
        self._update_followed()
        offset = time.time() - time.perf_counter()
        recorded = [trace.recorded.popleft() for _ in range(len(trace.recorded))]
        return HopRecords([replace(each, time=each.time + offset) for each in recorded])

    def _expire(self, name: str) -> None:
        del self._traces[name]
        self._update_followed()

    def _update_followed(self) -> None:
        followed: dict[bytes, list[_Trace]] = defaultdict(list)
        for trace in self._traces.values():
            for interface in trace.interfaces:
                followed[interface].append(trace)
        self._followed = dict(followed)
