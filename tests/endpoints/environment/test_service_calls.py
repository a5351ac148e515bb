"""Calls of a ROS service, with a fake of ROS."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import cast

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from endpoints.environment import service_calls
from endpoints.environment.ros import RosThread
from endpoints.environment.service_calls import MAX_IN_FLIGHT, TIMEOUT, ServiceCall, ServiceCaller
from rce.errors import NotFound, RceError, TimedOut
from tests.support.endpoints.fake_ros import InstantService

Answer = bytes | RceError


class Service(InstantService):
    """`answer` is the function that takes responses."""

    answer: Callable[[int, bytes], None]


def caller(monkeypatch: pytest.MonkeyPatch, service: Service, *, endless: bool) -> ServiceCaller:
    def client(ros: object, kind: object, name: str, answered: Callable[[int, bytes], None]) -> Service:
        service.answer = answered
        return service

    monkeypatch.setattr(service_calls, "RawClient", client)
    return ServiceCaller(cast(RosThread, service), None, "/name", "service /name", endless)


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
