"""Server-sent events: streams go on until the client, the server or the credentials end them."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest
from twisted.logger import LogEvent

from master.api import streams
from rce.api.views import Event
from rce.errors import Lost
from tests.support.endpoints.raw_robot import eventually
from tests.support.master.served import Served
from tests.support.master.sse import follow


async def test_revoked_key_ends_the_stream(served: Served) -> None:
    follower = await follow(served, "/events", "ann")
    (key,) = await served.master.users.keys.of("ann")
    await served.master.guard.revoke_key("ann", key.id)
    assert await follower.next() is None
    await follower.close()


async def test_stream_that_is_not_read_is_paused_and_can_be_revoked(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streams, "CLOSE_TIMEOUT", 0.1)
    sent = 0

    async def endless(position: int) -> AsyncIterator[Event]:
        nonlocal sent
        while True:
            sent += 1
            yield Event(f"run-{sent}", 0.0, "environment.failed", "ann", "ann/brain", text=100_000 * "x")

    monkeypatch.setattr(served.master.events, "follow", endless)
    follower = await follow(served, "/events", "ann")
    before = -1
    async with asyncio.timeout(20):
        while before != sent:
            before = sent
            await asyncio.sleep(0.2)
    assert 100_000 * sent < 100_000_000
    (key,) = await served.master.users.keys.of("ann")
    await served.master.guard.revoke_key("ann", key.id)
    with contextlib.suppress(ConnectionError):
        async with asyncio.timeout(20):
            while await follower.read_some():
                pass
    await follower.close()


def replace_events(
    served: Served, monkeypatch: pytest.MonkeyPatch, *texts: str, error: Exception | None = None
) -> None:
    """Let there be events of ann with these texts, and then an error or nothing any more."""

    async def events(position: int) -> AsyncIterator[Event]:
        for number, text in enumerate(texts):
            yield Event(f"run-{number}", 0.0, "environment.failed", "ann", "ann/brain", text=text)
        if error is not None:
            raise error
        await asyncio.Event().wait()

    monkeypatch.setattr(served.master.events, "follow", events)


async def test_error_is_the_last_event(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    replace_events(served, monkeypatch, "a", error=Lost("it went"))
    follower = await follow(served, "/events", "ann")
    assert (await follower.next())["text"] == "a"
    error = await follower.next()
    assert (error["code"], error["message"]) == ("lost", "it went")
    assert await follower.next() is None
    await follower.close()


async def test_defect_breaks_the_stream_off(
    served: Served, monkeypatch: pytest.MonkeyPatch, failures: list[LogEvent]
) -> None:
    replace_events(served, monkeypatch, "a", error=ZeroDivisionError())
    follower = await follow(served, "/events", "ann")
    assert (await follower.next())["text"] == "a"
    with contextlib.suppress(ConnectionError):
        assert b"0\r\n\r\n" not in await follower.read_some(), "it must not look complete"
    await eventually(lambda: bool(failures))
    assert [event["log_failure"].type for event in failures] == [ZeroDivisionError]
    failures.clear()
    await follower.close()


async def test_heartbeats_are_sent_while_nothing_happens(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "HEARTBEAT", 0.001)
    follower = await follow(served, "/events", "ann")
    received = b""
    async with asyncio.timeout(20):
        while received.count(streams.COMMENT) < 5:
            received += await follower.read_some()
    assert b"data" not in received
    await follower.close()


async def test_streams_of_a_user_are_limited(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "MAX_STREAMS", 1)
    first = await follow(served, "/events", "ann")
    refused = await served.ask("GET", "/events")
    assert (refused.status, refused.body["fields"]["limit"]) == (413, 1)
    of_bob = await follow(served, "/events", "bob")
    await of_bob.close()
    (key,) = await served.master.users.keys.of("ann")
    await served.master.guard.revoke_key("ann", key.id)
    assert await first.next() is None
    await first.close()
    await (await follow(served, "/events", "ann")).close()


async def test_head_of_a_stream_does_not_open_it(served: Served) -> None:
    answer = await served.ask("HEAD", "/events")
    assert (answer.status, answer.headers["content-type"]) == (200, "text/event-stream")
