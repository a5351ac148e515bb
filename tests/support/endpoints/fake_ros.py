"""Fake of the ROS node, for interfaces of an environment."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

from endpoints.data.hops import HopRecorder
from endpoints.environment.definitions import InstalledTypes
from endpoints.environment.interfaces import RosContext
from endpoints.environment.ros import Ros
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import RceError


class FakeListener:
    """Listener of no entity; the test runs it."""

    def __init__(self, action: Callable[[], None]) -> None:
        self.run = action


class InstantRos:
    """ROS node without entities; `retries` are run by the test."""

    def __init__(self) -> None:
        self.retries: list[Callable[[], None]] = []

    def listen(self, action: Callable[[], None], *entities: object) -> FakeListener:
        return FakeListener(action)

    def listen_to_events(self, action: Callable[[], None], of: object, kinds: object) -> FakeListener:
        return FakeListener(action)

    def end(self, listener: FakeListener) -> None: ...

    def retry(self, action: Callable[[], None]) -> None:
        self.retries.append(action)

    def call_later(self, seconds: float, action: Callable[[], None]) -> None:
        action()

    def context(self, report: Callable[[InterfaceSpec, RceError], None] = lambda spec, error: None) -> RosContext:
        """Return the context of interfaces that use this node."""
        return RosContext(cast(Ros, self), HopRecorder(), InstalledTypes([]), report)


class InstantService(InstantRos):
    """The ROS node, and the client of a service in it that keeps requests."""

    def __init__(self) -> None:
        super().__init__()
        self.is_available = True
        self.is_here = False
        self.requests: list[bytes] = []

    def available(self) -> bool:
        return self.is_available

    def server_is_here(self) -> bool:
        return self.is_here

    def destroy(self) -> None: ...

    def call(self, request: bytes) -> int:
        self.requests.append(request)
        return len(self.requests)
