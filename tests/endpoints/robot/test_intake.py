"""Bounds on what one client sends."""

from __future__ import annotations

import asyncio

from endpoints.robot.intake import MAX_CONVERTED, BadMessages, Conversions
from rce.errors import ConversionError, InvalidRequest, NotConnected, RceError


async def test_client_is_not_read_while_too_many_bytes_are_converted() -> None:
    paused: list[asyncio.Future[None]] = []
    results: list[RceError | None] = []
    conversions = Conversions(paused.append)
    go = asyncio.Event()

    async def convert() -> None:
        await go.wait()
        raise ConversionError("no")

    task = asyncio.create_task(convert())
    conversions.add(task, MAX_CONVERTED, results.append)
    assert len(paused) == 1
    go.set()
    await asyncio.wait([task])
    await asyncio.wait_for(paused[0], 30)
    assert [str(error) for error in results] == ["no"]


async def test_too_many_bad_messages_close_the_socket() -> None:
    reasons: list[str] = []
    bad = BadMessages(1, reasons.append)
    bad.count(NotConnected("not counted"))
    bad.count(InvalidRequest("one"))
    assert not reasons
    bad.count(InvalidRequest("two"))
    assert reasons == ["more than 1 bad messages within a minute; the last: two"]
