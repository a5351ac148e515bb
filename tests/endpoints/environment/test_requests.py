"""How many requests a service interface sends at once, and how long it waits; without ROS's part of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import cast

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")


from endpoints.environment.definitions import InstalledTypes
from endpoints.environment.interfaces import Surroundings
from endpoints.environment.ros import RosThread
from endpoints.environment.ros_services import RawClient
from endpoints.environment.services import IN_FLIGHT, TIMEOUT, ServiceClientInterface
from endpoints.frames import Message
from endpoints.hops import Watch
from endpoints.interface import MAX_REQUESTS, error_of
from endpoints.link import LoopLink
from rce.calls.endpoints import InterfaceSpec
from rce.errors import RceError

PEER = b"p" * 16


class Service:
    """In place of the ROS thread and the client in it: everything happens at once."""

    def __init__(self) -> None:
        self.there = True
        self.asked: list[bytes] = []
        self.postponed: list[Callable[[], None]] = []

    def post(self, action: Callable[[], None]) -> None:
        action()

    deliver = post

    def again(self, action: Callable[[], None]) -> None:
        self.postponed.append(action)

    def later(self, seconds: float, action: Callable[[], None]) -> None:
        action()

    def unwatch(self, client: object) -> None: ...

    def available(self) -> bool:
        return self.there

    def ask(self, request: bytes) -> int:
        self.asked.append(request)
        return len(self.asked)


class Robot:
    def __init__(self) -> None:
        self.heard: list[Message] = []

    def errors(self) -> list[str]:
        return [error.info.code for error in self.failures()]

    def failures(self) -> list[RceError]:
        return [error_of(message) for message in self.heard if message.error]


@pytest.fixture
async def parts() -> tuple[ServiceClientInterface, Service, Robot]:
    service, robot = Service(), Robot()
    spec = InterfaceSpec("11" * 16, "user/env", "tag", "ServiceClientInterface", "a/B", "/name")
    watch = Watch()
    around = Surroundings(cast(RosThread, service), watch, InstalledTypes([]), lambda spec, error: None)
    interface = ServiceClientInterface(spec, around)
    interface._client = cast(RawClient, service)
    interface.peers[PEER] = LoopLink("loop", lambda message, _: robot.heard.append(message), watch.left)
    return interface, service, robot


def ask(interface: ServiceClientInterface, count: int) -> None:
    for number in range(count):
        interface.receive(Message(PEER, str(number), str(number).encode()), interface.peers[PEER])


Parts = tuple[ServiceClientInterface, Service, Robot]


async def test_only_as_many_at_once_as_servers_keep(parts: Parts) -> None:
    interface, service, robot = parts
    ask(interface, 20)
    assert len(service.asked) == IN_FLIGHT
    for number in range(1, 21):
        interface._answered(number, b"answer")
    assert service.asked == [str(number).encode() for number in range(20)]
    assert [message.msg_id for message in robot.heard] == [str(number) for number in range(20)]
    assert {message.destination for message in robot.heard} == {PEER}


async def test_what_is_not_answered_fails_and_makes_room(parts: Parts) -> None:
    interface, service, robot = parts
    ask(interface, IN_FLIGHT + 1)
    for request in interface._asked.values():
        request.since -= TIMEOUT
    interface.tick(time.monotonic() + 0.1)
    assert robot.errors() == ["timed_out"] * IN_FLIGHT
    assert len(service.asked) == IN_FLIGHT + 1
    interface._answered(1, b"too late")
    assert len(robot.heard) == IN_FLIGHT


async def test_what_waited_too_long_for_its_turn_fails_too(parts: Parts) -> None:
    interface, _, robot = parts
    ask(interface, IN_FLIGHT + 2)
    interface.tick(time.monotonic() + TIMEOUT + 1)
    assert robot.errors() == ["timed_out"] * (IN_FLIGHT + 2)


async def test_too_many(parts: Parts) -> None:
    interface, _, robot = parts
    ask(interface, MAX_REQUESTS + 1)
    assert robot.errors() == ["limit_exceeded"]
    interface._answered(1, b"answer")
    ask(interface, 1)
    assert robot.errors() == ["limit_exceeded"]


async def test_requests_wait_for_the_service(parts: Parts) -> None:
    interface, service, robot = parts
    service.there = False
    ask(interface, 2)
    assert (service.asked, robot.heard) == ([], [])
    service.there = True
    service.postponed.pop()()
    assert len(service.asked) == 2


async def test_a_removed_interface_asks_no_more(parts: Parts) -> None:
    interface, service, _ = parts
    service.there = False
    ask(interface, 1)
    interface.close()
    service.there = True
    service.postponed.pop()()
    assert service.asked == []
