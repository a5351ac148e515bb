"""Messages of one interface on their way through conversion: their order, and what is converted at all."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Mapping
from typing import Any, cast
from unittest.mock import Mock

import pytest

from converters import Recipe, TypeRegistry, Wire
from endpoints.data.frames import Message
from endpoints.data.turns import SLICE
from endpoints.robot.conversion import FromRobot, Outgoing, ToRobot
from endpoints.robot.workers import Workers
from rce.errors import ConversionError, RceError
from rce.net.budget import Budget
from rce.protocol.blobs import Buffer
from rce.protocol.names import parse_type

CODEC = TypeRegistry().message(parse_type("std_msgs/String"))
SMALL = Wire(False, b'{"data":"small"}', {})
LARGE = bytes(2_000_000)


class HandWorkers:
    """Workers whose conversions end when the test says so, with the CDR or the JSON that it gives."""

    def __init__(self) -> None:
        self.asked: list[asyncio.Future[bytes]] = []

    async def encode(self, user: str, recipe: Recipe, wire: Wire) -> Buffer:
        return await self._ask()

    async def decode(self, user: str, recipe: Recipe, cdr: Buffer) -> Wire:
        return Wire(False, await self._ask(), {})

    def _ask(self) -> asyncio.Future[bytes]:
        self.asked.append(asyncio.get_running_loop().create_future())
        return self.asked[-1]


class Owner:
    """Owner of a queue, without limits."""

    budget = Budget(1 << 40)

    def evicted(self, count: int) -> None:
        """Do nothing."""


@pytest.fixture
def hand_workers() -> HandWorkers:
    return HandWorkers()


async def turns() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


def large() -> Wire:
    return Wire(False, b'{"data":"' + LARGE + b'"}', {})


async def test_small_message_from_a_robot_is_converted_in_place(hand_workers: HandWorkers) -> None:
    got: list[Buffer] = []
    assert FromRobot(cast(Workers, hand_workers), "u").convert(CODEC, SMALL, got.append) is None
    assert got == [CODEC.encode(SMALL)]


async def test_messages_from_a_robot_stay_in_order(hand_workers: HandWorkers) -> None:
    got: list[Buffer] = []
    lane = FromRobot(cast(Workers, hand_workers), "u")
    tasks = [lane.convert(CODEC, wire, got.append) for wire in (large(), large(), SMALL, large())]
    await turns()
    assert len(hand_workers.asked) == 3
    hand_workers.asked[2].set_result(b"third")
    hand_workers.asked[1].set_exception(ConversionError("bad"))
    await turns()
    assert got == []
    hand_workers.asked[0].set_result(b"first")
    results = await asyncio.gather(*(task for task in tasks if task is not None), return_exceptions=True)
    assert got == [b"first", CODEC.encode(SMALL), b"third"]
    assert [str(each) for each in results if each is not None] == ["bad"]
    assert lane.convert(CODEC, SMALL, got.append) is None, "nothing is before it any more"


class Sent:
    """Recorder of the output of a `ToRobot`."""

    def __init__(self, workers: HandWorkers) -> None:
        self.frames: list[bytes] = []
        self.errors: list[str] = []
        self.lane = ToRobot(cast(Workers, workers), "u", self._converted, self._failed)

    def _converted(self, outgoing: Outgoing, frame: Buffer, blobs: Mapping[str, Buffer]) -> None:
        self.frames.append(bytes(frame))

    def _failed(self, outgoing: Outgoing, error: RceError) -> None:
        self.errors.append(str(error))

    def put(self, payload: bytes, keep: int | None) -> int:
        return self.lane.put(Outgoing(CODEC, b"{", Message(bytes(16), "", payload), keep), len(payload), Owner())


async def test_message_to_a_robot_is_converted_when_the_one_before_has_left(hand_workers: HandWorkers) -> None:
    sent = Sent(hand_workers)
    assert sent.lane.empty
    for payload in (LARGE, LARGE, CODEC.encode(SMALL)):
        assert sent.put(payload, None) == 0
    await turns()
    assert (len(hand_workers.asked), sent.lane.backlog()) == (1, 2)
    sent.lane.proceed()
    assert len(hand_workers.asked) == 1, "one at a time"
    hand_workers.asked[0].set_result(b"first")
    await turns()
    assert (sent.frames, len(hand_workers.asked)) == ([b'{,"msg":first}}'], 1)
    sent.lane.proceed()
    await turns()
    hand_workers.asked[1].set_exception(ConversionError("bad"))
    await turns()
    assert sent.errors == ["bad"]
    assert sent.frames[1:] == [b'{,"msg":{"data":"small"}}}'], "an error does not stop the next"
    sent.lane.proceed()
    assert sent.lane.empty


async def test_dropped_message_is_not_converted(hand_workers: HandWorkers) -> None:
    sent = Sent(hand_workers)
    assert [sent.put(bytes([number]) + LARGE, 1) for number in range(4)] == [0, 0, 1, 1]
    await turns()
    for number in range(2):
        hand_workers.asked[number].set_result(b"")
        await turns()
        sent.lane.proceed()
        await turns()
    assert len(hand_workers.asked) == 2
    assert sent.lane.empty


async def test_closed_queue_converts_nothing(hand_workers: HandWorkers) -> None:
    sent = Sent(hand_workers)
    sent.put(LARGE, None)
    sent.put(LARGE, None)
    await turns()
    sent.lane.close()
    await turns()
    assert hand_workers.asked[0].cancelled()
    assert sent.frames == []


async def test_message_is_converted_once_for_all_who_want_the_same_form(hand_workers: HandWorkers) -> None:
    receivers, message = [Sent(hand_workers) for _ in range(50)], Message(bytes(16), "", LARGE)
    for number, each in enumerate(receivers):
        each.lane.put(Outgoing(CODEC, b"{%d" % number, message, 1), len(LARGE), Owner())
    await turns()
    receivers[0].lane.close()
    await turns()
    assert len(hand_workers.asked) == 1
    hand_workers.asked[0].set_result(b"{}")
    await turns()
    assert [each.frames for each in receivers[1:]] == [[b'{%d,"msg":{}}}' % number] for number in range(1, 50)]


async def test_many_receivers_get_a_message_in_slices_of_time(
    hand_workers: HandWorkers, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = itertools.count(0, SLICE / 4)
    monkeypatch.setattr("endpoints.robot.conversion.monotonic", lambda: next(clock))
    receivers, message = [Sent(hand_workers) for _ in range(9)], Message(bytes(16), "", LARGE)
    for each in receivers:
        each.lane.put(Outgoing(CODEC, b"{", message, 1), len(LARGE), Owner())
    await turns()
    hand_workers.asked[0].set_result(b"{}")
    passes = list[int]()
    while sum(passes) < 9:
        before = sum(len(each.frames) for each in receivers)
        await asyncio.sleep(0)
        passes.append(sum(len(each.frames) for each in receivers) - before)
    assert [each for each in passes if each] == [3, 3, 3]


async def test_defect_of_one_receiver_costs_the_others_nothing(hand_workers: HandWorkers) -> None:
    loop, defects = asyncio.get_running_loop(), list[dict[str, Any]]()
    loop.set_exception_handler(lambda _, context: defects.append(context))
    broken, whole, message = Sent(hand_workers), Sent(hand_workers), Message(bytes(16), "", LARGE)
    broken.lane._converted = Mock(side_effect=ValueError)
    for each in (broken, whole):
        each.lane.put(Outgoing(CODEC, b"{", message, 1), len(LARGE), Owner())
    await turns()
    hand_workers.asked[0].set_result(b"{}")
    await turns()
    loop.set_exception_handler(None)
    assert whole.frames == [b'{,"msg":{}}}']
    assert [type(each["exception"]) for each in defects] == [ValueError]


async def test_message_that_nobody_waited_for_is_converted_again(hand_workers: HandWorkers) -> None:
    first, second, message = Sent(hand_workers), Sent(hand_workers), Message(bytes(16), "", LARGE)
    first.lane.put(Outgoing(CODEC, b"{", message, 1), len(LARGE), Owner())
    await turns()
    first.lane.close()
    await turns()
    second.lane.put(Outgoing(CODEC, b"{", message, 1), len(LARGE), Owner())
    await turns()
    hand_workers.asked[1].set_result(b"2")
    await turns()
    assert second.frames == [b'{,"msg":2}}']


async def test_error_of_a_shared_conversion_reaches_all_who_wait(hand_workers: HandWorkers) -> None:
    receivers, message = [Sent(hand_workers) for _ in range(2)], Message(bytes(16), "", LARGE)
    for each in receivers:
        each.lane.put(Outgoing(CODEC, b"{", message, 1), len(LARGE), Owner())
    await turns()
    hand_workers.asked[0].set_exception(ConversionError("bad"))
    await turns()
    assert [each.errors for each in receivers] == [["bad"], ["bad"]]
