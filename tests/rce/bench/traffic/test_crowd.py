"""Crowd of the benchmark: what its robots make of the platform's answers."""

from __future__ import annotations

import asyncio
import time
from typing import Any, cast

import pytest

from rce.bench.traffic.crowd import Crowd, Load, Member, _send
from rce.errors import InvalidRequest


class Loop:
    """Socket whose messages the next robot gets at once."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.next: Member | None = None

    def send(self, text: bytes) -> None:
        self.sent.append(text)
        if self.next is not None:
            self.next.received(text)


def member(result: Crowd) -> tuple[Member, Loop]:
    made, socket = Member(1, result), Loop()
    made.socket = cast(Any, socket)
    return made, socket


async def test_command_ends_with_its_acknowledgement_or_its_error() -> None:
    robot, socket = member(Crowd(1, 1))
    command = asyncio.create_task(robot.command("CN", {}))
    await asyncio.sleep(0)
    assert socket.sent == [b'{"type": "CN", "id": 1, "data": {}}']
    robot.received(b'{"type":"ST","id":1,"data":{"topic":"ack"}}')
    await command
    command = asyncio.create_task(robot.command("CX", {}))
    await asyncio.sleep(0)
    robot.received(b'{"type":"ER","data":"no such interface","id":1}')
    with pytest.raises(InvalidRequest, match="no such interface"):
        await command


async def test_all_messages_are_sent_and_timed() -> None:
    result = Crowd(2, 1)
    (first, one), (second, other) = member(result), member(result)
    one.next, other.next = second, first
    began = time.perf_counter()
    elapsed = await _send([first, second], Load(2, 100.0, 50, 0.1), result)
    assert (result.sent, result.received, len(result.latencies)) == (20, 20, 20)
    assert [len(one.sent), len(other.sent)] == [10, 10]
    assert 0.1 <= elapsed <= time.perf_counter() - began
    assert all(0 <= each <= elapsed for each in result.latencies)
