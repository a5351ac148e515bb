"""Limits and timeouts of a service client interface, with a fake of ROS."""

from __future__ import annotations

import time
from typing import cast

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")


from endpoints.data.frames import Message
from endpoints.data.interface import MAX_REQUESTS, error_of
from endpoints.data.link import LoopLink
from endpoints.environment import service_calls
from endpoints.environment.ros import Ros
from endpoints.environment.service_calls import TIMEOUT, ServiceCaller
from endpoints.environment.service_slots import MAX_IN_FLIGHT, Slots
from endpoints.environment.services import ServiceClientInterface
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import RceError
from rce.net.budget import INTERFACE
from tests.support.endpoints.fake_ros import InstantService

PEER = b"p" * 16


class Robot:
    def __init__(self) -> None:
        self.received: list[Message] = []

    def errors(self) -> list[str]:
        return [error.info.code for error in self.failures()]

    def failures(self) -> list[RceError]:
        return [error_of(message) for message in self.received if message.error]


@pytest.fixture
async def parts(monkeypatch: pytest.MonkeyPatch) -> tuple[ServiceClientInterface, InstantService, Robot]:
    service, robot = InstantService(), Robot()
    spec = InterfaceSpec("11" * 16, "user/env", "tag", "ServiceClientInterface", "a/B", "/name")
    interface = ServiceClientInterface(spec, service.context())
    monkeypatch.setattr(service_calls, "RawClient", lambda *arguments: service)
    interface._caller = ServiceCaller(cast(Ros, service), None, "/name", "service /name", Slots())
    interface.peers[PEER] = LoopLink("loop", lambda message, _: robot.received.append(message), lambda message: None)
    return interface, service, robot


def send_requests(interface: ServiceClientInterface, count: int) -> None:
    for number in range(count):
        interface.receive(Message(PEER, str(number), str(number).encode()), interface.peers[PEER])


Parts = tuple[ServiceClientInterface, InstantService, Robot]


async def test_requests_in_flight_are_limited(parts: Parts) -> None:
    interface, service, robot = parts
    send_requests(interface, 20)
    assert len(service.requests) == MAX_IN_FLIGHT
    for number in range(1, 21):
        interface._caller._answered(number, b"answer")
    assert service.requests == [str(number).encode() for number in range(20)]
    assert [message.msg_id for message in robot.received] == [str(number) for number in range(20)]
    assert {message.destination for message in robot.received} == {PEER}


async def test_unanswered_requests_time_out_and_make_room(parts: Parts) -> None:
    interface, service, robot = parts
    send_requests(interface, MAX_IN_FLIGHT + 1)
    for request, _ in interface._caller._in_flight.values():
        request.since -= TIMEOUT
    interface.tick(time.monotonic() + 0.1)
    assert robot.errors() == ["timed_out"] * MAX_IN_FLIGHT
    assert len(service.requests) == MAX_IN_FLIGHT + 1
    interface._caller._answered(1, b"too late")
    assert len(robot.received) == MAX_IN_FLIGHT


async def test_requests_waiting_for_their_turn_time_out(parts: Parts) -> None:
    interface, _, robot = parts
    send_requests(interface, MAX_IN_FLIGHT + 2)
    interface.tick(time.monotonic() + TIMEOUT + 1)
    assert robot.errors() == ["timed_out"] * (MAX_IN_FLIGHT + 2)


async def test_bytes_of_unanswered_requests_are_limited(parts: Parts) -> None:
    interface, _, robot = parts
    size = INTERFACE // 4
    for number in range(6):
        interface.receive(Message(PEER, str(number), bytes(size)), interface.peers[PEER])
    assert robot.errors() == ["limit_exceeded"] * 2
    interface._caller._answered(1, b"answer")
    interface.receive(Message(PEER, "later", bytes(size)), interface.peers[PEER])
    assert [message.msg_id for message in robot.received if not message.error] == ["0"]
    assert robot.errors() == ["limit_exceeded"] * 2


async def test_unanswered_requests_are_limited(parts: Parts) -> None:
    interface, _, robot = parts
    send_requests(interface, MAX_REQUESTS + 1)
    assert robot.errors() == ["limit_exceeded"]
    interface._caller._answered(1, b"answer")
    send_requests(interface, 1)
    assert robot.errors() == ["limit_exceeded"]


async def test_requests_wait_until_service_appears(parts: Parts) -> None:
    interface, service, robot = parts
    service.is_available = False
    send_requests(interface, 2)
    assert (service.requests, robot.received) == ([], [])
    service.is_available = True
    service.retries.pop()()
    assert len(service.requests) == 2


async def test_removed_interface_sends_no_requests(parts: Parts) -> None:
    interface, service, _ = parts
    service.is_available = False
    send_requests(interface, 1)
    interface.close()
    service.is_available = True
    service.retries.pop()()
    assert service.requests == []
