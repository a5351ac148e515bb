"""Simulated endpoints."""

from __future__ import annotations

import time
from typing import Any

import msgspec
import pytest

from rce.bench.hollow import DONE, Hollow
from rce.control.calls.call import BatchResult, Call
from rce.control.calls.endpoints import AddRoute, Bind, InterfaceSpec, Route, Sync, Unbind
from rce.control.calls.watching import CountTraffic, Traffic
from rce.control.connection import Handlers


async def answer(handlers: Handlers, call: Call[Any]) -> bytes:
    good, pages = await handlers.answer(type(call).__name__, [msgspec.msgpack.encode(call)])
    assert good, pages
    return b"".join(pages)


async def traffic(handlers: Handlers) -> Traffic:
    return msgspec.msgpack.decode(await answer(handlers, CountTraffic()), type=Traffic)


def interface(name: str) -> Bind:
    return Bind(InterfaceSpec(name, "ann/brain", "pose", "PublisherInterface", "std_msgs/String"))


@pytest.fixture
def handlers() -> Handlers:
    return Hollow().handlers()


async def test_endpoint_has_nothing_to_reconcile(handlers: Handlers) -> None:
    assert msgspec.msgpack.decode(await answer(handlers, Sync()), type=BatchResult) == BatchResult()


async def test_call_without_effect_is_answered(handlers: Handlers) -> None:
    assert Unbind in DONE
    await answer(handlers, Unbind("a"))


async def test_traffic_is_that_of_the_bound_interfaces_with_their_peers(handlers: Handlers) -> None:
    await answer(handlers, interface("a"))
    await answer(handlers, interface("b"))
    await answer(handlers, AddRoute(Route("a", "far", "link")))
    found = (await traffic(handlers)).interfaces
    assert {name: set(each.peers) for name, each in found.items()} == {"a": {"far"}, "b": set()}


async def test_traffic_grows_ever_faster(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    handlers = Hollow().handlers()
    await answer(handlers, interface("a"))
    counted = []
    for _ in range(3):
        now[0] += 10
        counted.append((await traffic(handlers)).interfaces["a"].sent.messages)
    assert counted == [100, 400, 900]
