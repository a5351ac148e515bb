"""Calls of a ROS service, with a fake of ROS."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import cast

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from endpoints.environment import service_calls
from endpoints.environment.ros import Ros
from endpoints.environment.service_calls import TIMEOUT, ServiceCall, ServiceCaller
from endpoints.environment.service_slots import MAX_IN_FLIGHT, Slots
from rce.errors import NotFound, RceError, TimedOut
from tests.support.endpoints.fake_ros import InstantService

Answer = bytes | RceError


class Service(InstantService):
    """`answer` is the function that takes responses."""

    answer: Callable[[int, bytes], None]


def caller(
    monkeypatch: pytest.MonkeyPatch, service: Service, *, endless: bool, slots: Slots | None = None
) -> ServiceCaller:
    def client(ros: object, kind: object, name: str, answered: Callable[[int, bytes], None]) -> Service:
        service.answer = answered
        return service

    monkeypatch.setattr(service_calls, "RawClient", client)
    slots = None if endless else slots or Slots()
    return ServiceCaller(cast(Ros, service), None, "/name", "service /name", slots)


def make_calls(calling: ServiceCaller, count: int) -> list[Answer]:
    answers: list[Answer] = []
    for number in range(count):
        calling.call(ServiceCall(str(number).encode(), answers.append))
    return answers


def test_few_calls_are_in_flight_and_they_time_out(monkeypatch: pytest.MonkeyPatch) -> None:
    service = Service()
    calling = caller(monkeypatch, service, endless=False)
    answers = make_calls(calling, MAX_IN_FLIGHT + 2)
    assert len(service.requests) == MAX_IN_FLIGHT
    service.answer(1, b"first")
    assert answers == [b"first"]
    assert len(service.requests) == MAX_IN_FLIGHT + 1
    calling.expire(time.monotonic() + TIMEOUT + 1)
    assert [type(each) for each in answers[1:]] == [TimedOut] * (MAX_IN_FLIGHT + 1)


def test_endless_calls_are_all_in_flight_and_never_time_out(monkeypatch: pytest.MonkeyPatch) -> None:
    service = Service()
    calling = caller(monkeypatch, service, endless=True)
    answers = make_calls(calling, 3 * MAX_IN_FLIGHT)
    calling.expire(time.monotonic() + 100 * TIMEOUT)
    assert (len(service.requests), answers) == (3 * MAX_IN_FLIGHT, [])
    service.answer(3, b"late")
    assert answers == [b"late"]


def test_forgotten_call_gets_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    service, answers = Service(), list[Answer]()
    calling = caller(monkeypatch, service, endless=True)
    call = ServiceCall(b"", answers.append)
    calling.call(call)
    calling.forget(call)
    service.answer(1, b"late")
    assert answers == []


def test_call_of_missing_service_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    service, answers = Service(), list[Answer]()
    service.is_available = False
    calling = caller(monkeypatch, service, endless=True)
    calling.call(ServiceCall(b"", answers.append, since=time.monotonic() - 100))
    assert [type(each) for each in answers] == [NotFound]


def test_few_calls_of_all_interfaces_are_in_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    slots, services = Slots(), [Service() for _ in range(5)]
    callers = [caller(monkeypatch, service, endless=False, slots=slots) for service in services]
    answers = [make_calls(calling, 4) for calling in callers]

    def sent() -> int:
        return sum(len(service.requests) for service in services)

    assert sent() == MAX_IN_FLIGHT
    callers[4].destroy()
    services[0].answer(1, b"answer")
    assert sent() == MAX_IN_FLIGHT + 1
    callers[0].destroy()
    assert sent() == MAX_IN_FLIGHT + 4, "three more places"
    for service, got in zip(services[1:4], answers[1:4], strict=True):
        for number in range(1, 5):
            service.answer(number, b"answer")
        assert got == [b"answer"] * 4


def test_calls_of_a_server_in_this_process_need_no_places_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    slots, services = Slots(), [Service() for _ in range(5)]
    for service in services:
        service.is_here = True
        make_calls(caller(monkeypatch, service, endless=False, slots=slots), 4)
    assert [len(service.requests) for service in services] == [4] * 5
