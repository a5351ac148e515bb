"""Single messages followed through an endpoint, and how long all of them stay."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hand_turned import HandTurnedLoop

from endpoints import hops
from endpoints.frames import Message
from endpoints.hops import Watch
from rce.calls.watching import FollowMessages, Passage

OUT, IN, OTHER = bytes([1] * 16), bytes([2] * 16), bytes([3] * 16)


@pytest.fixture
def hand() -> Iterator[HandTurnedLoop]:
    loop = HandTurnedLoop()
    yield loop
    loop.close()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """What `perf_counter` says; the time of day is 1000 s ahead of it."""
    now = [5.0]
    monkeypatch.setattr(hops.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(hops.time, "time", lambda: now[0] + 1000)
    return now


def follow(hand: HandTurnedLoop, watch: Watch, trace: str = "t", *interfaces: bytes) -> list[Passage]:
    return hand.begin(watch.follow(FollowMessages(trace, [each.hex() for each in interfaces], 5.0))).result().passages


def through(watch: Watch, clock: list[float], name: str) -> None:
    """A message on its way out at 5.0, in at 5.1 and delivered at 5.3; and another interface's."""
    message = Message(OUT, name, b"", since=5.0)
    clock[0] = 5.1
    watch.left(message)
    watch.came(IN, message)
    clock[0] = 5.3
    watch.ended(IN, message)
    watch.left(Message(OTHER, name, b"", since=5.0))


def test_hops_of_followed_interfaces_are_noted_with_the_time_of_day(hand: HandTurnedLoop, clock: list[float]) -> None:
    watch = Watch()
    through(watch, clock, "before")
    assert follow(hand, watch, "t", OUT, IN) == []
    through(watch, clock, "m")
    out, into = OUT.hex(), IN.hex()
    assert follow(hand, watch, "t", OUT, IN) == [
        Passage(out, "m", out, "entered", 1005.0),
        Passage(out, "m", out, "sent", 1005.1),
        Passage(out, "m", into, "received", 1005.1),
        Passage(out, "m", into, "delivered", 1005.3),
    ]
    assert follow(hand, watch, "t", OUT, IN) == []


def test_an_answer_belongs_to_who_asked(hand: HandTurnedLoop, clock: list[float]) -> None:
    watch = Watch()
    follow(hand, watch, "t", IN)
    watch.left(Message(IN, "call", b"", destination=OUT))
    assert {each.source for each in follow(hand, watch, "t", IN)} == {OUT.hex()}


def test_who_follows_no_more_costs_nothing_after_a_while(hand: HandTurnedLoop, clock: list[float]) -> None:
    watch = Watch()
    follow(hand, watch, "one", OUT)
    hand.turn(4)
    follow(hand, watch, "two", OUT)
    hand.turn(4)
    through(watch, clock, "m")
    assert [each.hop for each in follow(hand, watch, "two", IN)] == ["entered", "sent"]
    assert follow(hand, watch, "one", OUT) == [], "it began anew"
    hand.turn(10)
    assert watch._followed == {}


def test_more_than_is_fetched_is_not_kept(
    hand: HandTurnedLoop, clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hops, "MOST", 10)
    watch = Watch()
    follow(hand, watch, "t", IN)
    for number in range(20):
        through(watch, clock, str(number))
    assert [each.message for each in follow(hand, watch, "t", IN)][-1] == "19"
    for number in range(5):
        through(watch, clock, str(number))
    assert len(follow(hand, watch, "t", IN)) == 10


def test_all_messages_are_timed(clock: list[float]) -> None:
    watch = Watch()
    before = [list(hops._stays.of(way).counts) for way in ("to_link", "from_link")]
    through(watch, clock, "m")
    after = [hops._stays.of(way).counts for way in ("to_link", "from_link")]
    assert [sum(now) - sum(then) for now, then in zip(after, before, strict=True)] == [2, 1]
