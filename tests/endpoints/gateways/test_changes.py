"""Waiting for the changes that a client has begun."""

from __future__ import annotations

import asyncio
import time

import pytest

from endpoints.gateways import changes
from endpoints.gateways.changes import Changes
from rce.errors import NotFound


async def test_waits_for_all_changes_that_have_begun() -> None:
    made = Changes()
    one, other, later = (asyncio.get_running_loop().create_future() for _ in range(3))
    made.begin(one)
    made.begin(other)
    waiting = asyncio.create_task(made.settle())
    await asyncio.sleep(0)
    made.begin(later)
    one.set_result(None)
    await asyncio.sleep(0)
    assert not waiting.done()
    began = time.monotonic()
    other.cancel()
    await waiting
    assert made.last >= began
    later.set_result(None)


async def test_waits_for_nothing_where_nothing_has_begun() -> None:
    await Changes().settle()


async def test_change_that_takes_long_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(changes, "LIMIT", 0.01)
    made = Changes()
    endless = asyncio.get_running_loop().create_future()
    made.begin(endless)
    await made.settle()
    assert not endless.done(), "nor ended"


async def test_changes_are_carried_out_one_after_the_other() -> None:
    made, order = Changes(), list[str]()

    async def change(name: str, fails: bool = False) -> None:
        async with made.carry_out():
            order.append(f"{name} begins")
            await asyncio.sleep(0)
            if fails:
                raise NotFound(name)
            order.append(f"{name} ends")

    results = await asyncio.gather(change("one", True), change("two"), made.settle(), return_exceptions=True)
    assert [type(each) for each in results] == [NotFound, type(None), type(None)]
    assert order == ["one begins", "two begins", "two ends"]
    await asyncio.wait_for(made.settle(), 1)
