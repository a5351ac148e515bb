"""Calls of one ROS service: they wait until it is there, and go out in order, a few at a time."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from endpoints.environment.discovery import SETTLING_TIME
from endpoints.environment.ros import Ros
from endpoints.environment.ros_services import RawClient, ServiceType
from endpoints.environment.service_slots import Slots
from rce.errors import ConversionError, NotFound, RceError, TimedOut

TIMEOUT = 30.0  # seconds for a response
DISCOVERY_TIMEOUT = 5.0  # seconds for which a call waits until its service appears


@dataclass(eq=False)
class ServiceCall:
    """A call.

    Attributes:
        request: The serialized request.
        done: Called with the serialized response, or with the error.
        sent: Called when the request has been handed to ROS.
        since: Monotonic time at which the call was made.
    """

    request: bytes
    done: Callable[[bytes | RceError], None]
    sent: Callable[[], None] = lambda: None
    since: float = field(default_factory=time.monotonic)


class ServiceCaller:
    """Calls of one service.

    Args:
        ros: The ROS node.
        kind: Class of the service.
        name: Name of the service.
        label: Name of the service for errors.
        slots: Places for requests at the server. None: it answers when it is done, however long that takes, so that
            there is no timeout, and any number in flight.
    """

    def __init__(self, ros: Ros, kind: ServiceType, name: str, label: str, slots: Slots | None) -> None:
        self._ros = ros
        self._label = label
        self._shared = self._slots = slots
        self._own = Slots()
        self._client = RawClient(ros, kind, name, self._answered)
        self._waiting: deque[ServiceCall] = deque()
        self._in_flight: dict[int, tuple[ServiceCall, Slots | None]] = {}
        self._settled = self._settling = False

    def available(self) -> bool:
        """Return True if a server of the service is there."""
        return self._client.available()

    def call(self, call: ServiceCall) -> None:
        """Make a call as soon as the service is there and not too many are in flight."""
        self._waiting.append(call)
        self._send()

    def expire(self, now: float) -> None:
        """End the calls that have timed out."""
        if self._shared is None:
            return
        while self._waiting and self._waiting[0].since + TIMEOUT < now:
            self._waiting.popleft().done(TimedOut(f"{self._label} was busy for {TIMEOUT:g} s"))
        late = [number for number, (call, _) in self._in_flight.items() if call.since + TIMEOUT < now]
        for number in late:
            if (call := self._end(number)) is not None:
                call.done(TimedOut(f"{self._label} did not answer within {TIMEOUT:g} s"))
        self._send()

    def forget(self, call: ServiceCall) -> None:
        """Take no answer to a call any more."""
        for number in [number for number, (each, _) in self._in_flight.items() if each is call]:
            self._end(number)

    def destroy(self) -> None:
        """Destroy the client; its calls get no answer."""
        self._waiting.clear()
        for number in list(self._in_flight):
            self._end(number)
        if self._slots is not None:
            self._slots.leave(self._send)
        self._client.destroy()

    def _send(self) -> None:
        while self._waiting:
            if not self._client.available():
                self._settled = False
                self._wait_for_service()
                return
            if not self._settled:
                self._settle()
                return
            slots = self._slots
            if slots is not None and not slots.take(self._send):
                return
            call = self._waiting.popleft()
            try:
                number = self._client.call(call.request)
            except ConversionError as error:
                call.done(error)
                if slots is not None:
                    slots.give_back()
            else:
                self._in_flight[number] = call, slots
                call.sent()

    def _settle(self) -> None:
        """Wait until a server that was just discovered has discovered this client: earlier responses would be lost."""
        if not self._settling:
            self._settling = True
            self._ros.call_later(SETTLING_TIME, self._settling_over)

    def _settling_over(self) -> None:
        self._settling, self._settled = False, True
        if self._shared is not None:  # a server of this process does not lose requests
            self._slots = self._own if self._client.server_is_here() else self._shared
        self._send()

    def _wait_for_service(self) -> None:
        while self._waiting and self._waiting[0].since + DISCOVERY_TIMEOUT < time.monotonic():
            error = NotFound(f"{self._label} did not appear within {DISCOVERY_TIMEOUT:g} s")
            self._waiting.popleft().done(error)
        self._ros.retry(self._send)

    def _answered(self, number: int, payload: bytes) -> None:
        call = self._end(number)
        if call is not None:  # else it has timed out
            call.done(payload)
            self._send()

    def _end(self, number: int) -> ServiceCall | None:
        """Take a call off those in flight; return None if it is none of them."""
        call, slots = self._in_flight.pop(number, (None, None))
        if slots is not None:
            slots.give_back()
        return call
