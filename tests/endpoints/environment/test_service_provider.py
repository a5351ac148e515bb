"""Requests of nodes to a service that a robot provides, with a fake of ROS."""

from __future__ import annotations

import time
from typing import cast

import msgspec
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from endpoints.data.frames import Message
from endpoints.data.link import LoopLink
from endpoints.environment.ros_services import Header, RawService
from endpoints.environment.service_calls import TIMEOUT
from endpoints.environment.services import ServiceProviderInterface
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import ConversionError, NotFound, RceError
from tests.support.endpoints.fake_ros import InstantRos

PEER = b"p" * 16
SPEC = InterfaceSpec("11" * 16, "user/env", "tag", "ServiceProviderInterface", "a/B", "/name")


class Service(InstantRos):
    """Fake of the ROS node and of the server in it, and of the robot at the other side of the link."""

    def __init__(self) -> None:
        super().__init__()
        self.answers: list[tuple[str, bytes]] = []
        self.refusal: RceError | None = None
        self.requests: list[Message] = []
        self.reports: list[RceError] = []
        self.interface = ServiceProviderInterface(SPEC, self.context(lambda _, error: self.reports.append(error)))
        self.interface._service = cast(RawService, self)
        self.link = LoopLink("loop", lambda message, _: self.requests.append(message), lambda message: None)
        self.interface.peers[PEER] = self.link

    def answer(self, header: Header, response: bytes) -> None:
        if self.refusal is not None:
            raise self.refusal
        self.answers.append((cast(str, header), response))

    def ask(self, header: str) -> str:
        """Let a node send a request; return the message id by which the robot answers it."""
        self.interface._forward(cast(Header, header), header.encode())
        return self.requests[-1].msg_id

    def respond(self, msg_id: str, payload: bytes, *, error: bool = False) -> None:
        self.interface.receive(Message(PEER, msg_id, payload, error=error), self.link)

    def reported(self) -> list[str]:
        return [error.info.code for error in self.reports]


@pytest.fixture
async def service() -> Service:
    return Service()


async def test_each_response_goes_to_the_node_that_asked(service: Service) -> None:
    first, second = service.ask("first"), service.ask("second")
    assert [message.payload for message in service.requests] == [b"first", b"second"]
    service.respond(second, b"to the second")
    service.respond(first, b"to the first")
    assert service.answers == [("second", b"to the second"), ("first", b"to the first")]
    assert service.reports == []


async def test_second_response_and_one_to_no_request_are_reported(service: Service) -> None:
    name = service.ask("once")
    for _ in range(2):
        service.respond(name, b"yes")
    service.respond("never asked", b"yes")
    assert (len(service.answers), service.reported()) == (1, ["not_found"]), "the same reason is reported once"


async def test_error_of_robot_is_reported_and_node_gets_nothing(service: Service) -> None:
    service.respond(service.ask("node"), msgspec.msgpack.encode(NotFound("no arm").info), error=True)
    assert (service.answers, service.reported()) == ([], ["not_found"])
    assert str(service.reports[0]) == "interface tag: a request to /name failed: no arm"


async def test_response_that_does_not_fit_is_reported(service: Service) -> None:
    service.refusal = ConversionError("it is not a serialized response")
    service.respond(service.ask("node"), b"junk")
    assert service.reported() == ["conversion"]


async def test_request_times_out_and_late_response_is_reported(service: Service) -> None:
    name = service.ask("node")
    service.interface.tick(time.monotonic() + TIMEOUT - 1)
    assert service.reports == []
    service.interface.tick(time.monotonic() + TIMEOUT + 1)
    assert service.reported() == ["timed_out"]
    service.respond(name, b"late")
    assert (service.answers, service.reported()) == ([], ["timed_out", "not_found"])


async def test_requests_that_last_peer_leaves_unanswered_are_reported(service: Service) -> None:
    for header in ("one", "two"):
        service.ask(header)
    service.interface.stopped()
    assert service.reported() == ["not_connected"]
    assert "2 requests unanswered" in str(service.reports[0])
    service.interface.stopped()
    service.interface.tick(time.monotonic() + TIMEOUT + 1)
    assert len(service.reports) == 1


async def test_request_without_peer_is_reported_and_forgotten(service: Service) -> None:
    service.interface.peers.clear()
    service.interface._forward(cast(Header, "node"), b"request")
    service.interface.tick(time.monotonic() + TIMEOUT + 1)
    assert service.reported() == ["not_connected"]
