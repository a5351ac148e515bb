"""Budgets of queues: who has to drop messages, and which ones."""

from __future__ import annotations

import weakref
from collections.abc import Iterator

import pytest

from rce.net.budget import SLACK, Budget
from rce.net.outbox import Outbox

LIMIT = 32_000


class Interface:
    """Owner of queues, which counts what others made it drop."""

    def __init__(self, budget: Budget) -> None:
        self.budget = budget
        self.lost = 0

    def evicted(self, count: int) -> None:
        self.lost += count


class Robot:
    """Robot that does not read, with a budget of its own within that of its user."""

    def __init__(self, user: Budget, limit: int = LIMIT) -> None:
        self.budget = Budget(limit, user)
        self.written: list[str] = []
        self.outbox: Outbox[str] = Outbox(self._write)
        self.outbox.pause()

    def _write(self, piece: str) -> bool:
        self.written.append(piece)
        return True

    def interface(self, limit: int = LIMIT) -> Interface:
        return Interface(Budget(limit, self.budget, spare=1))

    def put(self, interface: Interface, name: str, size: int, keep: int | None = 10_000) -> int:
        return self.outbox.put(str(id(interface)).encode(), iter([name]), keep, size, interface)


@pytest.fixture
def process() -> Budget:
    return Budget(4 * LIMIT)


@pytest.fixture
def user(process: Budget) -> Budget:
    return Budget(2 * LIMIT, process)


def test_queue_keeps_newest_messages_within_bytes_of_its_interface(user: Budget) -> None:
    robot = Robot(user)
    interface = robot.interface(1000)
    dropped = [robot.put(interface, str(number), 400) for number in range(5)]
    assert dropped == [0, 0, 1, 1, 1]
    assert (interface.budget.used, user.used) == (800, 800)
    robot.outbox.resume()
    assert robot.written == ["3", "4"]
    assert (interface.budget.used, user.used) == (0, 0)


def test_newest_message_waits_though_it_exceeds_the_bytes_of_its_interface(user: Budget) -> None:
    robot = Robot(user)
    interface = robot.interface(1000)
    assert [robot.put(interface, name, 5000) for name in "ab"] == [0, 1]
    robot.outbox.resume()
    assert robot.written == ["b"]


@pytest.mark.parametrize("level", ["session", "user", "process"])
def test_largest_queue_pays_when_a_larger_budget_is_exceeded(level: str) -> None:
    process = Budget(LIMIT if level == "process" else 10 * LIMIT)
    user = Budget(LIMIT if level == "user" else 10 * LIMIT, process)
    robot = Robot(user, LIMIT if level == "session" else 10 * LIMIT)
    other = robot if level == "session" else Robot(Budget(10 * LIMIT, process) if level == "process" else user)
    greedy, modest = robot.interface(), other.interface()
    other.put(modest, "kept", 100)
    for number in range(LIMIT // 1000 - 1):
        robot.put(greedy, str(number), 1000)
    assert (greedy.lost, modest.lost) == (0, 0)
    for number in range(10):
        other.put(modest, f"kept too {number}", 100)
    assert greedy.lost == 1 + 1  # what is too much, and the slack
    assert modest.lost == 0
    other.outbox.resume()
    assert len(other.written) >= 11


def test_sender_of_queue_that_drops_nothing_waits_while_the_user_has_used_its_budget(user: Budget) -> None:
    robot, other = Robot(user), Robot(user)
    greedy, faithful = other.interface(), robot.interface()
    robot.put(faithful, "one", 100, None)
    source = str(id(faithful)).encode()
    assert robot.outbox.wait_for_room(source) is None
    user.used += 2 * LIMIT
    assert user.full
    with pytest.raises(RuntimeError, match="no running event loop"):
        robot.outbox.wait_for_room(source)
    user.used -= 2 * LIMIT
    assert robot.outbox.wait_for_room(source) is None
    assert greedy.lost == 0


def test_queue_that_should_drop_nothing_drops_when_twice_the_budget_is_used(user: Budget) -> None:
    robot = Robot(user)
    interface = robot.interface()
    dropped = [robot.put(interface, str(number), LIMIT // 4, None) for number in range(10)]
    assert sum(dropped[:8]) == 0
    assert sum(dropped[8:]) > 0
    assert interface.budget.used <= 2 * LIMIT


@pytest.mark.parametrize("end", ["discard", "clear", "resume"])
def test_budget_is_free_again_when_messages_are_gone(user: Budget, end: str) -> None:
    robot = Robot(user)
    interface = robot.interface()
    for number in range(20):
        robot.put(interface, str(number), 1000)
    assert user.used == 20_000
    if end == "discard":
        robot.outbox.discard(str(id(interface)).encode())
    else:
        getattr(robot.outbox, end)()
    assert (user.used, interface.budget.used, user._holders) == (0, 0, {})


def test_message_that_is_being_sent_counts_until_it_is_sent(user: Budget) -> None:
    robot = Robot(user)
    interface = robot.interface()
    outbox: Outbox[str] = Outbox(lambda piece: False)

    def pieces() -> Iterator[str]:
        yield from "ab"

    outbox.put(b"a", pieces(), 1, 1000, interface)
    outbox.pause()
    assert user.used == 1000
    outbox.abort_current()
    assert user.used == 0


def test_search_for_largest_queue_is_rare(user: Budget, monkeypatch: pytest.MonkeyPatch) -> None:
    searches = 0
    drop = Budget._drop

    def counted(self: Budget) -> set[object]:
        nonlocal searches
        searches += 1
        return drop(self)  # type: ignore[return-value]

    monkeypatch.setattr(Budget, "_drop", counted)
    robot = Robot(user, LIMIT)
    interfaces = [robot.interface() for _ in range(10)]
    for number in range(10_000):
        robot.put(interfaces[number % 10], "", 10)
    assert searches <= (10_000 * 10 - LIMIT) / (LIMIT / SLACK) + 1


def test_budget_is_freed_without_the_garbage_collector(user: Budget) -> None:
    interface = Budget(LIMIT, user)
    freed = weakref.ref(interface)
    del interface
    assert freed() is None
