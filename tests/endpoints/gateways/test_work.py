"""Operations of one client that take longer."""

from __future__ import annotations

import asyncio

import pytest

from endpoints.gateways.work import MAX_HELD, MAX_TASKS, Work
from rce.errors import LimitExceeded


async def test_client_is_not_read_while_its_operations_hold_too_much() -> None:
    paused: list[asyncio.Future[None]] = []
    work, go = Work(paused.append), asyncio.Event()

    async def wait() -> None:
        await go.wait()

    work.run(wait(), MAX_HELD)
    assert not paused
    work.run(wait(), 1)
    assert len(paused) == 1
    for _ in range(MAX_TASKS - 2):
        work.run(wait())
    with pytest.raises(LimitExceeded, match="in progress"):
        work.run(wait())
    go.set()
    await asyncio.wait_for(paused[0], 30)


async def test_operations_end_with_the_client() -> None:
    work, ended = Work(lambda _: None), asyncio.Event()

    async def wait() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            ended.set()

    work.run(wait())
    await asyncio.sleep(0)
    work.cancel()
    await asyncio.wait_for(ended.wait(), 30)
