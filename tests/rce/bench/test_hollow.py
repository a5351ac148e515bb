"""Simulated endpoints."""

from __future__ import annotations

import time

import pytest

from rce.bench.hollow import DONE, Hollow
from rce.control.calls.call import BatchResult
from rce.control.calls.endpoints import AddRoute, Bind, InterfaceSpec, Route, Sync, Unbind
from rce.control.calls.watching import CountTraffic
from rce.control.connection import Handlers
from tests.support.control import answer


def interface(name: str) -> Bind:
    return Bind(InterfaceSpec(name, "ann/brain", "pose", "PublisherInterface", "std_msgs/String"))


@pytest.fixture
def handlers() -> Handlers:
    return Hollow().handlers()


async def test_endpoint_has_nothing_to_reconcile(handlers: Handlers) -> None:
    assert await answer(handlers, Sync()) == BatchResult()


async def test_call_without_effect_is_answered(handlers: Handlers) -> None:
    assert Unbind in DONE
    await answer(handlers, Unbind("a"))


async def test_traffic_is_that_of_the_bound_interfaces_with_their_peers(handlers: Handlers) -> None:
    await answer(handlers, interface("a"))
    await answer(handlers, interface("b"))
    await answer(handlers, AddRoute(Route("a", "far", "link")))
    found = (await answer(handlers, CountTraffic())).interfaces
    assert {name: set(each.peers) for name, each in found.items()} == {"a": {"far"}, "b": set()}


async def test_traffic_grows_ever_faster(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    handlers = Hollow().handlers()
    await answer(handlers, interface("a"))
    counted = []
    for _ in range(3):
        now[0] += 10
        counted.append((await answer(handlers, CountTraffic())).interfaces["a"].sent.messages)
    assert counted == [100, 400, 900]
