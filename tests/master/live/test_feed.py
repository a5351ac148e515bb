"""Feed: a snapshot for each watcher, then what changed and may be seen, unless the watcher is too slow."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from master.execution.readiness import Readiness
from master.graph.records import Environment, EnvironmentOptions, Parameter, Robot
from master.graph.state import State
from master.live.feed import PAUSE, Feed
from master.live.gauges import Changed
from master.live.presenter import Presenter
from master.live.view_cache import ViewCache
from rce.api.views import Kind, Usage
from tests.support.hand_turned import HandTurnedLoop


class Seen:
    """Watcher that sees everything of these users; `free` says whether it can take more."""

    def __init__(self, *users: str) -> None:
        self.free = True
        self.got: list[dict[str, Any]] = []
        self.asked: list[tuple[str, str, bool]] = []
        self._users = users

    def sees(self, kind: Kind, key: str, gone: bool = False) -> bool:
        self.asked.append((kind, key, gone))
        return key.partition("/")[0] in self._users

    def send(self, message: bytes) -> None:
        self.got.append(json.loads(message))


class Show:
    """A feed of ann's environment `brain`, whose gauges do nothing by themselves."""

    def __init__(self, hand: HandTurnedLoop) -> None:
        self.hand = hand
        self.state = State()
        self.presenter = Presenter(self.state, readiness := Readiness())
        self.measuring: list[Callable[[Changed], None]] = []
        self.feed = Feed(ViewCache(self.presenter, readiness), self._measure)
        self.put(Environment("ann/brain", EnvironmentOptions(), "r", "m1"))

    def _measure(self, changed: Callable[[Changed], None]) -> Callable[[], None]:
        self.measuring.append(changed)
        return lambda: self.measuring.remove(changed)

    def put(self, record: Environment | Robot | Parameter) -> None:
        table: Any = {Environment: self.state.environments, Robot: self.state.robots, Parameter: self.state.parameters}[
            type(record)
        ]
        self.hand.do(lambda: table.put(record))

    def watch(self, *users: str) -> Seen:
        watcher = Seen(*users)
        self.hand.do(lambda: self.feed.add(watcher))
        return watcher

    def leave(self, watcher: Seen) -> None:
        self.hand.do(lambda: self.feed.remove(watcher))

    def tick(self) -> None:
        self.hand.turn(PAUSE)


@pytest.fixture
def show(hand: HandTurnedLoop) -> Iterator[Show]:
    show = Show(hand)
    yield show
    for watcher in list(show.feed._sent):
        show.leave(watcher)  # type: ignore[arg-type]


def test_first_message_is_a_snapshot(show: Show) -> None:
    (message,) = show.watch("ann").got
    assert (message["seq"], message["snapshot"], list(message["put"])) == (1, True, ["environments"])
    assert list(message["put"]["environments"]) == ["ann/brain"]


def test_changes_are_sent_together_after_the_pause(show: Show) -> None:
    watcher = show.watch("ann")
    show.put(Parameter("ann/brain", "a", 1))
    show.put(Parameter("ann/brain", "b", 2))
    assert len(watcher.got) == 1
    show.tick()
    _, message = watcher.got
    assert (message["seq"], "snapshot" in message) == (2, False)
    assert sorted(message["put"]["parameters"]) == ["ann/brain/:a", "ann/brain/:b"]
    assert message["put"]["environments"]["ann/brain"]["parameters"] == 2


def test_nothing_is_sent_while_nothing_changes(show: Show) -> None:
    watcher = show.watch("ann")
    show.hand.do(lambda: show.feed.view_cache.mark("environments", "ann/brain"))
    show.hand.turn(10 * PAUSE)
    assert len(watcher.got) == 1


def test_watcher_gets_what_it_sees_and_counts_its_own_messages(show: Show) -> None:
    ann, bob = show.watch("ann"), show.watch("bob")
    assert bob.got == [{"seq": 1, "snapshot": True}]
    show.put(Robot("ann/r1", "west", "s"))
    show.tick()
    show.put(Robot("bob/r1", "west", "s"))
    show.tick()
    assert [message["seq"] for message in ann.got] == [1, 2]
    assert [(message["seq"], message.get("put")) for message in bob.got[1:]] == [
        (2, {"robots": {"bob/r1": bob.got[1]["put"]["robots"]["bob/r1"]}})
    ]


def test_watcher_is_told_of_what_is_gone(show: Show) -> None:
    """A record that is gone cannot be looked up, so it is asked whether the watcher saw it."""
    ann, bob = show.watch("ann"), show.watch("bob")
    show.hand.do(lambda: show.state.environments.drop("ann/brain"))
    show.tick()
    assert ann.got[1:] == [{"seq": 2, "drop": {"environments": ["ann/brain"]}}]
    assert len(bob.got) == 1
    assert ann.asked[-1] == ("environments", "ann/brain", True)


def test_slow_watcher_gets_a_snapshot_once_it_can_take_more(show: Show) -> None:
    slow, quick = show.watch("ann"), show.watch("ann")
    slow.free = False
    for value in range(3):
        show.put(Parameter("ann/brain", "a", value))
        show.tick()
    assert (len(slow.got), len(quick.got)) == (1, 4)
    slow.free = True
    show.hand.do(lambda: show.feed.catch_up(slow))
    assert (slow.got[1]["seq"], slow.got[1]["snapshot"]) == (2, True)
    assert slow.got[1]["put"]["parameters"]["ann/brain/:a"]["value"] == 2
    show.put(Parameter("ann/brain", "a", 3))
    show.tick()
    assert (slow.got[2]["seq"], "snapshot" in slow.got[2]) == (3, False)


def test_watcher_that_missed_nothing_has_nothing_to_catch_up_with(show: Show) -> None:
    watcher = show.watch("ann")
    show.hand.do(lambda: show.feed.catch_up(watcher))
    assert len(watcher.got) == 1


def test_watcher_that_was_removed_gets_nothing(show: Show) -> None:
    watcher, stays = show.watch("ann"), show.watch("ann")
    show.leave(watcher)
    show.leave(watcher)
    show.put(Parameter("ann/brain", "a", 1))
    show.tick()
    assert (len(watcher.got), len(stays.got)) == (1, 2)


def test_measured_figures_are_sent(show: Show) -> None:
    watcher = show.watch("ann")
    show.presenter.usage = {"ann/brain": Usage(0.5, 1000)}
    (changed,) = show.measuring
    show.hand.do(lambda: changed({"environments": {"ann/brain"}, "interfaces": set()}))
    show.tick()
    assert watcher.got[1]["put"]["environments"]["ann/brain"]["usage"] == {"cores": 0.5, "memory": 1000}


def test_nothing_is_measured_or_made_while_nobody_watches(show: Show) -> None:
    one, other = show.watch("ann"), show.watch("bob")
    assert (len(show.measuring), show.feed.watched) == (1, True)
    show.leave(one)
    assert (len(show.measuring), show.feed.watched) == (1, True)
    show.leave(other)
    assert (show.measuring, show.feed.watched, show.feed.view_cache.views) == ([], False, {})
    show.put(Parameter("ann/brain", "a", 1))
    assert not any(show.feed.view_cache.marked.values())
    assert show.watch("ann").got[0]["put"]["parameters"]["ann/brain/:a"]["value"] == 1
