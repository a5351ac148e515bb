"""Fake of the ROS thread, for interfaces of an environment."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from endpoints.data.hops import HopRecorder
from endpoints.environment.definitions import InstalledTypes
from endpoints.environment.interfaces import RosContext
from endpoints.environment.ros import RosThread
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import RceError

T = TypeVar("T")


class InstantRos:
    """ROS thread that runs every action at once; `retries` are run by the test."""

    def __init__(self) -> None:
        self.retries: list[Callable[[], None]] = []

    def post(self, action: Callable[[], None]) -> None:
        action()

    deliver = post

    async def run(self, action: Callable[[], T]) -> T:
        return action()

    def retry(self, action: Callable[[], None]) -> None:
        self.retries.append(action)

    def call_later(self, seconds: float, action: Callable[[], None]) -> None:
        action()

    def remove_waitable(self, waitable: object) -> None: ...

    def context(self, report: Callable[[InterfaceSpec, RceError], None] = lambda spec, error: None) -> RosContext:
        """Return the context of interfaces that use this thread."""
        return RosContext(cast(RosThread, self), HopRecorder(), InstalledTypes([]), report)


class InstantService(InstantRos):
    """The ROS thread, and the client of a service in it that keeps requests."""

    def __init__(self) -> None:
        super().__init__()
        self.is_available = True
        self.is_here = False
        self.requests: list[bytes] = []

    def available(self) -> bool:
        return self.is_available

    def server_is_here(self) -> bool:
        return self.is_here

    def call(self, request: bytes) -> int:
        self.requests.append(request)
        return len(self.requests)
