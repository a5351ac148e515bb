"""Users take turns at the event loop."""

from __future__ import annotations

import asyncio

import pytest

from endpoints.data import link as link_module
from endpoints.data import turns as turns_module
from endpoints.data.frames import Message, pieces
from endpoints.data.link import Link, StreamLink
from endpoints.data.turns import Turns
from tests.support.endpoints.ends import A

FLOOD = 50  # messages of each link


async def test_users_have_turns_in_a_circle_whatever_each_has_queued() -> None:
    turns, given = Turns(), []
    for user, count in (("ann", 40), ("bob", 2), ("cem", 1)):
        for number in range(count):
            turns.wait(user, lambda user=user, number=number: given.append((user, number)))  # type: ignore[misc]
    while turns.busy("ann"):  # noqa: ASYNC110  # the passes of the loop give the turns
        await asyncio.sleep(0)
    assert given[:5] == [("ann", 0), ("bob", 0), ("cem", 0), ("ann", 1), ("bob", 1)]
    assert given[5:] == [("ann", number) for number in range(2, 40)]


@pytest.mark.parametrize("works", [1, 4])
async def test_each_pass_of_the_loop_gives_turns_for_one_slice(monkeypatch: pytest.MonkeyPatch, works: int) -> None:
    """A pass for each turn would cost more than a small message."""
    turns, given, now = Turns(), [0], [0.0]
    monkeypatch.setattr(turns_module, "monotonic", lambda: now[0])

    def work() -> None:
        given[0] += 1
        now[0] += 1.01 * turns_module.SLICE / works
        if given[0] < 4 * works:
            turns.wait("ann", work)

    turns.wait("ann", work)
    for passes in range(1, 5):
        await asyncio.sleep(0)
        assert given == [passes * works]


async def test_failing_work_does_not_end_the_turns_of_others() -> None:
    turns, given = Turns(), []

    def fail() -> None:
        raise ZeroDivisionError

    asyncio.get_running_loop().set_exception_handler(lambda loop, context: None)
    turns.wait("ann", fail)
    turns.wait("bob", lambda: given.append("bob"))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert given == ["bob"]


class Reception:
    """Links of several users, of which each message takes a turn; `delivered` has the links in order."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(link_module, "SLICE", -1.0)
        self.turns = Turns()
        self.delivered: list[str] = []

    def link(self, name: str, user: str) -> StreamLink:
        def deliver(message: Message, link: Link) -> None:
            self.delivered.append(link.name)

        return StreamLink(name, deliver, lambda link, reason: None, lambda message: None, None, self.turns, user)

    async def until_delivered(self, count: int) -> None:
        while len(self.delivered) < count:  # noqa: ASYNC110  # the passes of the loop give the turns
            await asyncio.sleep(0)


def receive(link: StreamLink, count: int) -> None:
    """Let a link receive messages that came in one piece."""
    data = b"".join(b"".join(piece) for number in range(count) for piece in pieces(Message(A, str(number), b""), 0))
    link.get_buffer(0)[: len(data)] = data
    link.buffer_updated(len(data))


async def test_message_of_another_user_waits_for_one_turn_of_a_flood(monkeypatch: pytest.MonkeyPatch) -> None:
    reception = Reception(monkeypatch)
    flood = [reception.link(f"flood {number}", "ann") for number in range(40)]
    for each in flood:
        receive(each, FLOOD)
    calm = reception.link("calm", "bob")
    before = len(reception.delivered)
    receive(calm, 2)
    await reception.until_delivered(40 * FLOOD + 2)
    first, second = [place for place, name in enumerate(reception.delivered) if name == "calm"]
    assert first == before, "at once: this user has used no turn"
    assert second - first <= 2, "after one turn of the other user"


async def test_links_of_one_user_share_its_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    reception = Reception(monkeypatch)
    many = [reception.link(f"many {number}", "ann") for number in range(10)]
    one = reception.link("one", "bob")
    for each in (*many, one):
        receive(each, FLOOD)
    await reception.until_delivered(11 * FLOOD)
    last = max(place for place, name in enumerate(reception.delivered) if name == "one")
    assert last <= 2 * FLOOD + 2, "every second turn"


async def test_messages_of_a_link_stay_in_order_and_closed_link_delivers_no_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reception = Reception(monkeypatch)
    link = reception.link("closed", "ann")
    receive(link, FLOOD)
    link.close()
    for _ in range(FLOOD):
        await asyncio.sleep(0)
    assert reception.delivered == ["closed"]
    assert not reception.turns.busy("ann")
