"""Events: what happens becomes events, and followers continue where they stopped or are told what they missed."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import msgspec
import pytest

from master.graph.records import Connection, Environment, EnvironmentOptions, Interface, Process, Record, Robot, Role
from master.graph.state import State, Table
from master.live import events as events_module
from master.live.events import Events
from rce.api.views import Event
from rce.control.calls.knowledge import NotedChange
from rce.protocol import messages as m
from tests.support.hand_turned import HandTurnedLoop


class Story:
    """Events of a state, and followers of them."""

    def __init__(self, hand: HandTurnedLoop) -> None:
        self.hand = hand
        self.state = State()
        self.events = hand.do(lambda: Events(self.state))

    def happen(self, *tags: str) -> None:
        """Add an event for each of these environments of ann."""

        def happen() -> None:
            for tag in tags:
                self.events.status_sent("ann", m.EnvironmentEvent(tag, "ready"))

        self.hand.do(happen)

    def follow(self, id: str = "") -> AsyncIterator[Event]:
        return self.events.follow(self.events.position(id))

    def next(self, follower: AsyncIterator[Event]) -> asyncio.Task[Event]:
        async def take() -> Event:
            return await anext(follower)

        return self.hand.begin(take())

    def objects(self, follower: AsyncIterator[Event], count: int) -> list[str]:
        return [self.next(follower).result().object for _ in range(count)]

    def seen(self) -> list[Event]:
        """Return all events so far."""
        return [msgspec.msgpack.decode(event, type=Event) for event in self.events._kept]


@pytest.fixture
def story(hand: HandTurnedLoop) -> Story:
    return Story(hand)


# --- sources ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("status", "type", "object", "text"),
    [
        (m.EnvironmentEvent("brain", "ready", address="10.128.0.2"), "environment.ready", "ann/brain", ""),
        (m.EnvironmentEvent("brain", "failed", "no image"), "environment.failed", "ann/brain", "no image"),
        (m.EnvironmentEvent("brain", "lost", "killed"), "environment.lost", "ann/brain", "killed"),
        (m.EnvironmentEvent("brain", "gone", "ended"), "environment.lost", "ann/brain", "ended"),
        (m.NodeEvent("brain", "n", -9, ["last words"]), "node.died", "ann/brain/n", "ended with status -9"),
        (m.RecorderEvent("brain", "box", "quota"), "recorder.ended", "ann/brain/box", "quota"),
        (m.LimitEvent("environment brain: memory"), "limit.reached", "ann", "environment brain: memory"),
    ],
)
def test_status_of_a_user_is_an_event(story: Story, status: m.StatusData, type: str, object: str, text: str) -> None:
    story.events.status_sent("ann", status)
    (event,) = story.seen()
    assert (event.type, event.user, event.object, event.text) == (type, "ann", object, text)
    if isinstance(status, m.NodeEvent):
        assert (event.status, event.lines) == (-9, ["last words"])


def test_records_that_come_and_go_are_events(story: Story) -> None:
    state = story.state
    records: list[tuple[Table[Any], Record]] = [
        (state.environments, Environment("ann/brain", EnvironmentOptions(), "r", "m1")),
        (state.robots, Robot("ann/r1", "west", "s")),
        (state.connections, Connection("ann/r1/a", "ann/brain/b")),
    ]
    for table, record in records:
        table.put(record)
        table.put(record)  # a change is no event
        table.drop(record.key)
    assert [(event.type, event.user, event.object) for event in story.seen()] == [
        ("environment.gone", "ann", "ann/brain"),  # that it has come is told when it is ready
        ("robot.came", "ann", "ann/r1"),
        ("robot.left", "ann", "ann/r1"),
        ("connection.made", "ann", "ann/r1/a ann/brain/b"),
        ("connection.gone", "ann", "ann/r1/a ann/brain/b"),
    ]


def test_interface_that_leaves_with_its_robot_is_an_event(story: Story) -> None:
    added = Interface("1", "ann/brain", "pose", "PublisherInterface", "std_msgs/String", by="ann/r1")
    for present in (True, False):
        if present:
            story.state.robots.put(Robot("ann/r1", "west", "s"))
        story.state.interfaces.put(added)
        story.state.interfaces.drop(added.key)
        story.state.robots.drop("ann/r1")
    (gone,) = [event for event in story.seen() if event.type == "interface.gone"]
    assert (gone.object, gone.text) == ("ann/brain/pose", "robot r1, which added it, has left")


@pytest.mark.parametrize("role", ["robot", "container", "service"])
def test_machines_that_join_and_leave_are_events_of_no_user(story: Story, role: Role) -> None:
    for here in (True, False):
        story.events.process_moved(Process("m1", role, "1"), here)
    assert [(event.type, event.user, event.object) for event in story.seen()] == [
        ("machine.joined", "", "m1"),
        ("machine.left", "", "m1"),
    ]


def test_processes_of_environments_are_no_machines(story: Story) -> None:
    story.events.process_moved(Process("ann/brain", "environment", "1"), True)
    assert story.seen() == []


# --- followers --------------------------------------------------------------------------------------------------------


def test_follower_without_a_position_gets_new_events_only(story: Story) -> None:
    story.happen("old")
    follower = story.follow()
    waiting = story.next(follower)
    assert not waiting.done()
    story.happen("new")
    assert waiting.result().object == "ann/new"


def test_follower_continues_after_its_last_event(story: Story) -> None:
    story.happen("a", "b", "c")
    first, *_ = story.seen()
    assert story.objects(story.follow(first.id), 2) == ["ann/b", "ann/c"]


def test_all_followers_are_woken(story: Story) -> None:
    waiting = [story.next(story.follow()) for _ in range(3)]
    story.happen("a")
    assert [task.result().object for task in waiting] == ["ann/a"] * 3


@pytest.mark.parametrize("id", ["0badcafe-1", "nonsense", "0badcafe-", "{life}-x", "{life}-99"])
def test_id_that_is_not_known_gets_everything_after_a_notice(story: Story, id: str) -> None:
    """It is of another life of the Master, or no id at all."""
    story.happen("a", "b")
    life = story.seen()[0].id.partition("-")[0]
    follower = story.follow(id.format(life=life))
    assert story.next(follower).result().type == "missed"
    assert story.objects(follower, 2) == ["ann/a", "ann/b"]


def test_follower_that_is_too_late_is_told_and_continues_with_the_oldest(
    story: Story, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(events_module, "MAX_EVENTS", 3)
    follower = story.follow()
    story.happen("a", "b", "c", "d", "e")
    missed = story.next(follower).result()
    assert (missed.type, missed.user, missed.object) == ("missed", "", "")
    assert story.objects(follower, 3) == ["ann/c", "ann/d", "ann/e"]
    waiting = story.next(follower)
    story.happen("f")
    assert waiting.result().object == "ann/f"


def test_id_of_the_notice_leads_to_the_oldest_event(story: Story, monkeypatch: pytest.MonkeyPatch) -> None:
    """A client that reconnects right after it misses nothing more."""
    monkeypatch.setattr(events_module, "MAX_EVENTS", 2)
    story.happen("a", "b", "c")
    missed = story.next(story.follow("0badcafe-1")).result()
    assert story.objects(story.follow(missed.id), 2) == ["ann/b", "ann/c"]


def test_kept_events_are_bounded_by_bytes(story: Story, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events_module, "MAX_SIZE", 9000)
    lines = [f"{number:<999}" for number in range(50)]
    for _ in range(5):
        story.hand.do(lambda: story.events.status_sent("ann", m.NodeEvent("brain", "n", 1, lines)))
    kept = story.seen()
    assert [event.lines for event in kept] == [lines[-4:]] * 2
    assert story.next(story.follow(kept[0].id)).result() == kept[1]


def test_changes_of_knowledge_are_told_one_by_one_or_as_a_number(story: Story) -> None:
    change = NotedChange("added", "object", "cup.blue", "ann", "ann", False)
    others = NotedChange("removed", "recipe", "serve.tea", "ann", "root", True)
    story.hand.do(lambda: story.events.knowledge_changed([change, others]))
    found = [(each.type, each.user, each.object, each.text, each.public) for each in story.seen()]
    assert found == [
        ("knowledge.added", "ann", "ann/object/cup.blue", "", False),
        ("knowledge.removed", "ann", "ann/recipe/serve.tea", "by root", True),
    ]
    story.hand.do(lambda: story.events.knowledge_changed([change] * 60 + [others]))
    assert [(each.type, each.text) for each in story.seen()[2:]] == [
        ("knowledge.changed", "60 changes of entries"),
        ("knowledge.changed", "1 changes of entries"),
    ]
