"""Hop times of all messages, and traces of single ones."""

from __future__ import annotations

import time

import pytest

from endpoints.data import hops
from endpoints.data.frames import Message
from endpoints.data.hops import HopRecorder
from rce.control.calls.watching import FollowMessages, HopRecord
from tests.support.hand_turned import HandTurnedLoop

OUT, IN, OTHER = bytes([1] * 16), bytes([2] * 16), bytes([3] * 16)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Time of `perf_counter`; the time of day is 1000 s ahead of it."""
    now = [5.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(time, "time", lambda: now[0] + 1000)
    return now


def follow(hand: HandTurnedLoop, recorder: HopRecorder, trace: str = "t", *interfaces: bytes) -> list[HopRecord]:
    return hand.begin(recorder.follow(FollowMessages(trace, [each.hex() for each in interfaces], 5.0))).result().records


def pass_message(recorder: HopRecorder, clock: list[float], name: str) -> None:
    """A message that enters at 5.0, is sent and received at 5.1 and delivered at 5.3; and one of another interface."""
    message = Message(OUT, name, b"", entered_at=5.0)
    clock[0] = 5.1
    recorder.sent(message)
    recorder.received(IN, message)
    clock[0] = 5.3
    recorder.delivered(IN, message)
    recorder.sent(Message(OTHER, name, b"", entered_at=5.0))


def test_hops_of_followed_interfaces_are_recorded_with_time_of_day(hand: HandTurnedLoop, clock: list[float]) -> None:
    recorder = HopRecorder()
    pass_message(recorder, clock, "before")
    assert follow(hand, recorder, "t", OUT, IN) == []
    pass_message(recorder, clock, "m")
    out, into = OUT.hex(), IN.hex()
    assert follow(hand, recorder, "t", OUT, IN) == [
        HopRecord(out, "m", out, "entered", 1005.0),
        HopRecord(out, "m", out, "sent", 1005.1),
        HopRecord(out, "m", into, "received", 1005.1),
        HopRecord(out, "m", into, "delivered", 1005.3),
    ]
    assert follow(hand, recorder, "t", OUT, IN) == []


def test_response_belongs_to_trace_of_its_request(hand: HandTurnedLoop, clock: list[float]) -> None:
    recorder = HopRecorder()
    follow(hand, recorder, "t", IN)
    recorder.sent(Message(IN, "call", b"", destination=OUT))
    assert {each.source for each in follow(hand, recorder, "t", IN)} == {OUT.hex()}


def test_message_of_several_senders_is_recorded_for_each_that_is_followed(hand: HandTurnedLoop) -> None:
    recorder = HopRecorder()
    follow(hand, recorder, "t", OUT)
    recorder.sent(Message(bytes(16), "m", b"", senders=(IN, OUT)))
    assert {(each.source, each.interface) for each in follow(hand, recorder, "t", OUT)} == {(OUT.hex(), OUT.hex())}


def test_trace_expires_without_further_calls(hand: HandTurnedLoop, clock: list[float]) -> None:
    recorder = HopRecorder()
    follow(hand, recorder, "one", OUT)
    hand.turn(4)
    follow(hand, recorder, "two", OUT)
    hand.turn(4)
    pass_message(recorder, clock, "m")
    assert [each.hop for each in follow(hand, recorder, "two", IN)] == ["entered", "sent"]
    assert follow(hand, recorder, "one", OUT) == [], "a new trace has begun"
    hand.turn(10)
    assert recorder._followed == {}


def test_trace_keeps_only_newest_hops(
    hand: HandTurnedLoop, clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hops, "MAX_RECORDED", 10)
    recorder = HopRecorder()
    follow(hand, recorder, "t", IN)
    for number in range(20):
        pass_message(recorder, clock, str(number))
    assert [each.message for each in follow(hand, recorder, "t", IN)][-1] == "19"
    for number in range(5):
        pass_message(recorder, clock, str(number))
    assert len(follow(hand, recorder, "t", IN)) == 10


def test_durations_of_all_messages_are_observed(clock: list[float]) -> None:
    recorder = HopRecorder()
    before = [list(hops._durations.labels(hop).counts) for hop in ("to_link", "from_link")]
    pass_message(recorder, clock, "m")
    after = [hops._durations.labels(hop).counts for hop in ("to_link", "from_link")]
    assert [sum(now) - sum(then) for now, then in zip(after, before, strict=True)] == [2, 1]
