"""Lease: who leads, when a Master steps down, and that two never lead at the same time by a common clock."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest

from master.storage.lease import ASK_EVERY, LEASE, RENEW_EVERY, STEP_DOWN, Lease
from rce.errors import Unavailable
from tests.support.hand_turned import HandTurnedLoop


class Database:
    """The row in memory, by a clock of its own."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.term = 0
        self.url = ""
        self.until = 0.0
        self.offset = 0.0  # of the database's clock

    @property
    def now(self) -> float:
        return self.loop.time() + self.offset


class Row:
    """Access of one Master to the row; `cut` breaks it, and `hangs` lets requests wait."""

    def __init__(self, database: Database) -> None:
        self.database = database
        self.cut = False
        self.hangs: asyncio.Event | None = None

    async def _answer(self) -> Database:
        if self.cut:
            raise Unavailable("cut")
        if self.hangs is not None:
            await self.hangs.wait()
        return self.database

    async def take(self, url: str, seconds: float) -> tuple[int, str]:
        database = await self._answer()
        if database.until > database.now:
            return 0, database.url
        database.term, database.url, database.until = database.term + 1, url, database.now + seconds
        return database.term, url

    async def renew(self, term: int, seconds: float) -> bool:
        database = await self._answer()
        if database.term != term:
            return False
        database.until = database.now + seconds
        return True

    async def release(self, term: int) -> None:
        await self.renew(term, 0.0)


class Member:
    """A Master that takes the lease, if it can."""

    def __init__(self, hand: HandTurnedLoop, database: Database, url: str) -> None:
        self.hand = hand
        self.row = Row(database)
        self.lease = hand.do(lambda: Lease(self.row))
        self.taking = hand.begin(self.lease.take(url))

    @property
    def holds(self) -> bool:
        return self.hand.do(lambda: self.lease.holds)


@pytest.fixture
def hand() -> Iterator[HandTurnedLoop]:
    hand = HandTurnedLoop()
    yield hand
    for task in asyncio.all_tasks(hand):
        task.cancel()
    hand.settle()
    hand.close()


@pytest.fixture
def database(hand: HandTurnedLoop) -> Database:
    return Database(hand)


def test_first_master_leads_and_the_second_knows_it(hand: HandTurnedLoop, database: Database) -> None:
    first, second = Member(hand, database, "first"), Member(hand, database, "second")
    hand.turn(10 * LEASE)
    assert first.holds
    assert first.lease.term == 1
    assert not second.holds
    assert not second.taking.done()
    assert second.lease.leader == "first"


def test_standby_leads_soon_after_the_end_of_the_lease(hand: HandTurnedLoop, database: Database) -> None:
    first, second = Member(hand, database, "first"), Member(hand, database, "second")
    hand.turn(RENEW_EVERY * 3)
    first.row.cut = True
    hand.turn(LEASE + ASK_EVERY)
    assert second.holds
    assert second.lease.term == 2
    assert first.lease.lost.result() == f"the lease could not be renewed for {STEP_DOWN:g} s"


def test_at_no_moment_two_lead(hand: HandTurnedLoop, database: Database) -> None:
    members = [Member(hand, database, name) for name in ("first", "second", "third")]
    hand.turn(3.3)
    for _ in range(2):
        next(each for each in members if each.holds).row.cut = True
        for _ in range(200):
            hand.turn(0.1)
            assert sum(each.holds for each in members) <= 1
    assert [each.lease.term for each in members if each.holds] == [3]


def test_leader_counts_from_before_a_renewal_that_took_long(hand: HandTurnedLoop, database: Database) -> None:
    first = Member(hand, database, "first")
    hand.turn(RENEW_EVERY - 0.1)
    first.row.hangs = hand.do(asyncio.Event)
    hand.turn(3)  # the renewal has begun at RENEW_EVERY
    hand.do(first.row.hangs.set)
    first.row.hangs = hand.do(asyncio.Event)
    hand.turn(RENEW_EVERY + STEP_DOWN - hand.time() - 0.1)
    assert first.holds
    hand.turn(0.2)
    assert not first.holds


def test_renewal_that_does_not_end_ends_the_leadership(hand: HandTurnedLoop, database: Database) -> None:
    first = Member(hand, database, "first")
    first.row.hangs = hand.do(asyncio.Event)
    hand.turn(STEP_DOWN - 0.1)
    assert first.holds
    hand.turn(0.2)
    assert not first.holds
    assert first.lease.lost.done()


def test_leader_that_another_one_replaced_steps_down(hand: HandTurnedLoop, database: Database) -> None:
    """The clock of the database jumps forward, and a standby takes the lease early."""
    first, second = Member(hand, database, "first"), Member(hand, database, "second")
    hand.turn(0.1)
    database.offset = 2 * LEASE
    hand.turn(ASK_EVERY)
    assert second.holds
    hand.turn(RENEW_EVERY)
    assert first.lease.lost.result() == "another Master leads"


def test_released_lease_is_taken_at_once(hand: HandTurnedLoop, database: Database) -> None:
    first, second = Member(hand, database, "first"), Member(hand, database, "second")
    hand.begin(first.lease.release())
    assert not first.holds
    hand.turn(ASK_EVERY)
    assert second.holds


def test_lease_is_taken_when_the_database_is_back(hand: HandTurnedLoop, database: Database) -> None:
    first = Member(hand, database, "first")
    second = Member(hand, database, "second")
    second.row.cut = True
    hand.begin(first.lease.release())
    hand.turn(LEASE)
    assert not second.holds
    second.row.cut = False
    hand.turn(ASK_EVERY)
    assert second.holds


def test_leader_answers_no_call_of_who_knows_a_later_one(hand: HandTurnedLoop, database: Database) -> None:
    first = Member(hand, database, "first")
    hand.do(lambda: first.lease.check(1))
    with pytest.raises(Unavailable, match="is a standby"):
        hand.do(lambda: first.lease.check(2))


def test_leader_without_a_lease_answers_nothing(hand: HandTurnedLoop, database: Database) -> None:
    first = Member(hand, database, "first")
    first.row.cut = True
    hand.turn(STEP_DOWN)
    with pytest.raises(Unavailable, match="first leads"):
        hand.do(lambda: first.lease.check(0))
