"""The audit log: what an entry has, that none is lost, and which are found and forgotten."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any, ClassVar

import pytest
import sqlalchemy as sa

from master.access import audit as module
from master.access.audit import DAY, MAX_OBJECT, Audit, AuditFilter, Origin, names_of, object_of
from master.storage.store import Store
from rce.api.roles import Principal
from rce.api.views import AuditView
from rce.errors import Forbidden, NotFound
from rce.protocol import messages as m
from rce.protocol.names import MAX_TAG

ANN = Principal("ann", "user", "k1")
ORIGIN = Origin("rest", "10.0.0.1")


@pytest.fixture
def audit(store: Store) -> Audit:
    return Audit(store)


async def find(audit: Audit, **wanted: Any) -> list[AuditView]:
    return await audit.find(AuditFilter(**wanted), None, 100)


async def objects(audit: Audit, **wanted: Any) -> list[str]:
    """Return the objects of the entries that match, oldest first."""
    return [each.object for each in await find(audit, **wanted)][::-1]


def note(audit: Audit, *things: str, who: Principal | None = ANN, owner: str = "ann") -> None:
    for thing in things:
        audit.note(who, "node.create", owner, thing, ORIGIN)


# --- entries ----------------------------------------------------------------------------------------------------------


async def test_entry_tells_who_did_what_to_what_from_where_and_when(audit: Audit) -> None:
    before = time.time()
    audit.note(ANN, "node.create", "bob", "bob/brain/n", ORIGIN, NotFound("no"))
    (entry,) = await find(audit)
    assert before <= entry.time <= time.time()
    assert (entry.user, entry.key, entry.action, entry.object) == ("ann", "k1", "node.create", "bob/brain/n")
    assert (entry.result, entry.door, entry.address) == ("not_found", "rest", "10.0.0.1")


@pytest.mark.parametrize(
    ("error", "result"),
    [(None, "ok"), (Forbidden("no"), "forbidden"), (asyncio.CancelledError(), "cancelled"), (OSError(), "internal")],
)
async def test_result_is_ok_or_the_code_of_the_error(audit: Audit, error: BaseException | None, result: str) -> None:
    audit.note(ANN, "node.create", "ann", "ann/e", ORIGIN, error)
    assert [each.result for each in await find(audit)] == [result]


async def test_texts_of_clients_are_cut_and_can_be_stored(audit: Audit) -> None:
    audit.note(None, "login", "o" * 1000, "a\0" + "b" * 5000, Origin("rest", "x" * 100))
    (entry,) = await find(audit, concerning="o" * MAX_TAG)
    assert entry.object == "a\ufffd" + "b" * (MAX_OBJECT - 2)
    assert entry.address == "x" * 64


async def test_action_in_a_context_is_recorded_when_it_ends(audit: Audit) -> None:
    with audit.auditing("machine.add", "", "beta", ORIGIN) as action:
        assert await find(audit) == []
        action.who = ANN
    with pytest.raises(NotFound), audit.auditing("machine.add", "", "gamma", ORIGIN):
        raise NotFound("no")
    assert [(each.user, each.object, each.result) for each in await find(audit)][::-1] == [
        ("ann", "beta", "ok"),
        ("", "gamma", "not_found"),
    ]


async def test_quiet_action_is_recorded_only_if_it_fails(audit: Audit) -> None:
    for error in (None, Forbidden("no")):
        try:
            with audit.auditing("data.read", "ann", "ann/@desk", ORIGIN) as action:
                action.quiet = True
                if error:
                    raise error
        except Forbidden:
            pass
    assert [each.result for each in await find(audit)] == ["forbidden"]


@pytest.mark.parametrize(
    ("command", "thing"),
    [
        (m.CreateContainer("brain"), "ann/brain"),
        (m.AddNode("brain", "n", "pkg", "exe"), "ann/brain/n"),
        (m.SetParameter("brain", "rate", 1, "n"), "ann/brain/n/rate"),
        (m.AddInterface("r1", "i", "SubscriberConverter", "a/B", "/topic"), "ann/r1/i"),
        (m.Connect("r1/i", "brain/i"), "ann/r1/i/brain/i"),
    ],
)
def test_object_of_a_command_is_its_path(command: m.Command, thing: str) -> None:
    assert object_of("ann", command) == thing


def test_names_in_a_body_are_noted_without_its_secrets() -> None:
    class Body:
        name = "carl"
        role = "user"
        password = "secret"
        users: ClassVar = ["bob", "eve"]

    assert names_of(Body()) == ["carl", "user", "bob,eve"]
    assert names_of(object()) == []


# --- writing ----------------------------------------------------------------------------------------------------------


async def test_unauthenticated_clients_do_not_fill_the_disk(audit: Audit, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_UNAUTHENTICATED", 3)
    now = 600.0
    monkeypatch.setattr(time, "time", lambda: now)
    note(audit, *"abcde", who=None)
    note(audit, "f")  # whoever has authenticated is always recorded
    now = 659.9
    note(audit, "g", who=None)
    now = 660.0
    note(audit, "h", who=None)
    assert await objects(audit) == ["a", "b", "c", "f", "h"]


async def test_entries_that_come_soon_after_each_other_share_a_transaction(
    audit: Audit, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    transactions = []
    run = store.run

    async def count(work: Callable[[sa.Connection], Any]) -> Any:
        transactions.append(work)
        return await run(work)

    monkeypatch.setattr(store, "run", count)
    for thing in "abc":
        note(audit, thing)
        for _ in range(3):
            await asyncio.sleep(0)
    assert await objects(audit) == ["a", "b", "c"]
    assert len(transactions) == 1


async def test_entries_wait_for_the_database(audit: Audit, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    async def fail(work: object) -> None:
        raise sa.exc.OperationalError("locked", None, Exception())

    with monkeypatch.context() as patched:
        patched.setattr(store, "run", fail)
        note(audit, "a", "b")
        await audit.flush()
    note(audit, "c")
    assert await objects(audit) == ["a", "b", "c"]


async def test_memory_is_bounded_while_the_database_fails(
    audit: Audit, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_WAITING", 2)
    note(audit, "a", "b", "c")
    assert await objects(audit) == ["a", "b"]


async def test_reader_who_disconnects_does_not_cancel_writing(
    audit: Audit, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, begun, may_write = store.run, asyncio.Event(), asyncio.Event()

    async def wait_and_run(work: Callable[[sa.Connection], Any]) -> Any:
        begun.set()
        await may_write.wait()
        return await run(work)

    monkeypatch.setattr(store, "run", wait_and_run)
    note(audit, "a")
    reader = asyncio.ensure_future(find(audit))
    await asyncio.wait_for(begun.wait(), 20)
    reader.cancel()
    await asyncio.wait([reader])
    may_write.set()
    assert await objects(audit) == ["a"]


# --- reading ----------------------------------------------------------------------------------------------------------


async def test_entries_are_found_by_their_fields(audit: Audit) -> None:
    audit.note(ANN, "node.create", "ann", "ann/e/n", ORIGIN)
    audit.note(Principal("bob", "user"), "node.remove", "ann", "ann/e/n", ORIGIN, NotFound("no"))
    audit.note(Principal("bob", "user"), "node.create", "bob", "bob/f", ORIGIN)
    assert await objects(audit, user="bob") == ["ann/e/n", "bob/f"]
    assert await objects(audit, action="node.create") == ["ann/e/n", "bob/f"]
    assert await objects(audit, result="ok", user="bob") == ["bob/f"]
    assert len(await find(audit, concerning="ann")) == 2  # what ann did, and what others did to her things
    assert len(await find(audit, concerning="")) == 0


async def test_object_stands_for_all_below_it(audit: Audit) -> None:
    note(audit, "ann/e", "ann/e/n", "ann/e1", "ann/_/x", "ann/%")
    assert await objects(audit, object="ann/e") == ["ann/e", "ann/e/n"]
    assert await objects(audit, object="ann/_") == ["ann/_/x"]
    assert len(await find(audit, object="ann")) == 5


async def test_times_are_from_since_up_to_until(audit: Audit, monkeypatch: pytest.MonkeyPatch) -> None:
    for now in (1.0, 2.0, 3.0):
        monkeypatch.setattr(time, "time", lambda now=now: now)
        note(audit, f"{now:g}")
    assert await objects(audit, since=2.0) == ["2", "3"]
    assert await objects(audit, until=2.0) == ["1"]
    assert await objects(audit, since=0.0, until=3.0) == ["1", "2"]


async def test_pages_go_on_before_an_id(audit: Audit) -> None:
    note(audit, *"abcde")
    first = await audit.find(AuditFilter(), None, 2)
    second = await audit.find(AuditFilter(), first[-1].id, 2)
    assert [each.object for each in (*first, *second)] == ["e", "d", "c", "b"]


async def test_old_entries_are_forgotten(audit: Audit, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1000.0
    monkeypatch.setattr(time, "time", lambda: now)
    note(audit, "old")
    now += DAY
    note(audit, "new")
    await audit.flush()
    await audit.forget(0)  # keeps all
    await audit.forget(1)
    assert len(await find(audit)) == 2
    now += 1
    await audit.forget(1)
    assert await objects(audit) == ["new"]


async def test_tidying_goes_on_after_a_database_failure(audit: Audit, monkeypatch: pytest.MonkeyPatch) -> None:
    days: list[float] = []

    async def forget(count: float) -> None:
        days.append(count)
        if len(days) == 2:
            raise asyncio.CancelledError
        raise sa.exc.OperationalError("locked", None, Exception())

    monkeypatch.setattr(module, "DAY", 0.0)
    monkeypatch.setattr(audit, "forget", forget)
    with pytest.raises(asyncio.CancelledError):
        await audit.tidy(7)
    assert days == [7, 7]
