"""Perspective Broker as both sides of a control connection use it."""

from __future__ import annotations

import asyncio
from typing import Any

from twisted.internet.error import ConnectionDone
from twisted.internet.testing import StringTransport
from twisted.logger import LogEvent
from twisted.python.failure import Failure

from rce.control.base_broker import BaseBroker
from rce.control.decoder import MalformedMessage


def burst(number: int) -> tuple[Any, list[Any], bytes]:
    """Return a broker, the messages that it has handled, and the bytes of some messages for it."""
    broker: Any = BaseBroker()
    sender: Any = BaseBroker()
    handled: list[Any] = []
    broker.makeConnection(StringTransport())
    broker.callExpressionReceived = handled.append
    sender.makeConnection(line := StringTransport())
    line.clear()
    for request in range(number):
        sender.sendCall(b"answer", request, b"")
    return broker, handled, line.value()


async def test_burst_is_handled_in_slices() -> None:
    """Between two slices the event loop serves others, such as robots."""
    broker, handled, data = burst(10)
    broker.dataReceived(data)
    seen = {len(handled)}
    assert broker.transport.producerState == "paused"
    while len(handled) < 10:
        await asyncio.sleep(0)
        seen.add(len(handled))
    assert seen == {4, 8, 10}
    assert broker.transport.producerState == "producing"


async def test_messages_of_a_lost_connection_are_not_handled() -> None:
    broker, handled, data = burst(10)
    broker.dataReceived(data)
    broker.connectionLost(Failure(ConnectionDone()))
    broker.dataReceived(data)
    for _ in range(5):
        await asyncio.sleep(0)
    assert len(handled) == 4


async def test_connection_with_a_malformed_message_in_a_later_slice_is_closed(failures: list[LogEvent]) -> None:
    broker, handled, data = burst(6)
    broker.dataReceived(data + b"\x00\xff")
    for _ in range(5):
        await asyncio.sleep(0)
    assert broker.transport.disconnecting
    assert len(handled) == 6
    assert [type(event["log_failure"].value) for event in failures] == [MalformedMessage]
    failures.clear()
