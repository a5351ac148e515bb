"""Numbered messages: losses, duplicates and order."""

from __future__ import annotations

import asyncio
import time
from typing import cast

import pytest

from rce.bench.chaos import flows
from rce.bench.chaos.flows import Flow
from rce.client import Publisher, Subscriber
from rce.errors import TimedOut
from rce.protocol.messages import DropEvent


class Ends:
    """Publisher that loses the numbers in `lose` and delivers others, and its subscriber."""

    dropped = 0

    def __init__(self, flow: Flow, lose: tuple[int, ...] = ()) -> None:
        self._flow = flow
        self._lose = lose

    def offer(self, message: dict[str, str], keep: int) -> bool:
        if int(message["data"]) not in self._lose:
            self._flow.receive(message)
        return True


@pytest.fixture
def flow() -> Flow:
    return Flow("r0 to r1")


async def send(flow: Flow, ends: Ends, monkeypatch: pytest.MonkeyPatch) -> None:
    """Send at least ten messages."""
    monkeypatch.setattr(flows, "PERIOD", 0)
    flow.begin(cast(Publisher, ends), cast(Subscriber, ends))
    before = time.monotonic()
    while len(flow._sent) < 10:
        await flow.wait_for_message(before, 10)
        before = time.monotonic()
    await flow.end()


async def test_messages_that_arrive_are_no_problem(flow: Flow, monkeypatch: pytest.MonkeyPatch) -> None:
    await send(flow, Ends(flow), monkeypatch)
    count = flow.count()
    assert count.sent == count.received >= 10
    assert count.problems() == []


async def test_lost_message_is_a_problem_unless_it_was_reported(flow: Flow, monkeypatch: pytest.MonkeyPatch) -> None:
    await send(flow, Ends(flow, (3, 5)), monkeypatch)
    assert flow.count().problems() == ["flow r0 to r1: 2 messages were lost without a reason, 0 drops were reported"]
    flow.report(DropEvent("hear", 1, "Robot endpoint"))
    flow.report(DropEvent("hear", 2, "Robot endpoint"))
    assert flow.count().reported == 2
    assert flow.count().problems() == []


async def test_messages_sent_before_the_first_one_that_arrived_can_be_forgotten(
    flow: Flow, monkeypatch: pytest.MonkeyPatch
) -> None:
    await send(flow, Ends(flow, (0, 1)), monkeypatch)
    assert flow.lost() == ([0, 1], [])
    flow.forget_earlier()
    assert flow.lost() == ([], [])


async def test_end_waits_for_messages_under_way(flow: Flow, monkeypatch: pytest.MonkeyPatch) -> None:
    class Slow(Ends):
        def offer(self, message: dict[str, str], keep: int) -> bool:
            asyncio.get_running_loop().call_later(2 * flows.POLL_INTERVAL, self._flow.receive, message)
            return True

    await send(flow, Slow(flow), monkeypatch)
    count = flow.count()
    assert count.received == count.sent


async def test_end_does_not_wait_for_a_lost_message(flow: Flow, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flows, "SETTLED", 0.0)
    flow.begin(cast(Publisher, Ends(flow, (0,))), cast(Subscriber, Ends(flow)))
    await asyncio.sleep(0)  # the first message is sent
    await flow.end()
    assert flow.lost() == ([0], [])


async def test_message_may_be_lost_with_the_process_that_had_it(flow: Flow, monkeypatch: pytest.MonkeyPatch) -> None:
    began = time.monotonic()
    await send(flow, Ends(flow, (3,)), monkeypatch)
    flow.disturb(began, time.monotonic())
    assert (flow.count().lost, flow.count().lost_in_faults) == (0, 1)


async def test_message_that_was_under_way_for_long_may_be_lost(flow: Flow) -> None:
    flow._sent = {0: 0.0, 1: 10.0, 2: 30.0}
    flow._received = {0: 1.0, 2: 31.0}
    flow.disturb(20.0, 25.0)
    assert flow.lost() == ([], [1])


async def test_message_that_was_lost_before_a_fault_is_a_problem(flow: Flow) -> None:
    flow._sent = {0: 0.0, 1: 10.0, 2: 10.1}
    flow._received = {0: 1.0, 2: 10.2}
    flow.disturb(10.3, 11.0)
    assert flow.lost() == ([1], [])


def test_duplicates_and_changes_of_order_are_problems(flow: Flow) -> None:
    for number in (1, 3, 2, 3):
        flow.receive({"data": str(number)})
    assert flow.count().problems() == [
        "flow r0 to r1: 1 messages arrived twice",
        "flow r0 to r1: 1 messages arrived after later ones",
    ]


def test_drops_of_a_new_interface_are_added(flow: Flow) -> None:
    for count in (4, 6, 1):
        flow.report(DropEvent("hear", count, "Robot endpoint"))
    assert flow.count().reported == 7


async def test_wait_for_a_message_ends(flow: Flow) -> None:
    with pytest.raises(TimedOut, match="no message of flow r0 to r1 arrived"):
        await flow.wait_for_message(time.monotonic(), 0)
