# ruff: noqa: E402  (imports after importorskip)
"""Docker's event stream: delivery to the event loop, interruptions and the end."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.docker import events as module
from containers.docker.events import Event, Events

FILTERS = {"type": "container"}


def event(run: str) -> Event:
    return {"Action": "die", "Actor": {"Attributes": {"rce.run": run}}}


class Stream:
    """Stream of events that goes on until it is closed, or breaks with an error."""

    def __init__(self, *events: Event, error: Exception | None = None) -> None:
        self.closed = threading.Event()
        self._events = events
        self._error = error

    def __iter__(self) -> Iterator[Event]:
        yield from self._events
        if self._error is not None:
            raise self._error
        self.closed.wait(60)

    def close(self) -> None:
        self.closed.set()


class Api:
    """Docker's API, which answers with one stream after the other."""

    def __init__(self, *streams: Stream | Exception) -> None:
        self.asked: list[dict[str, Any]] = []
        self.before: Callable[[], None] = lambda: None
        self._streams = iter(streams)

    def events(self, **words: Any) -> Stream:
        self.asked.append(words)
        self.before()
        stream = next(self._streams)
        if isinstance(stream, Exception):
            raise stream
        return stream


class Follower:
    """Recorder of what `Events` reports: `resumed`, and the runs of events."""

    def __init__(self, api: Api) -> None:
        self.seen: asyncio.Queue[str] = asyncio.Queue()
        self.on_event: Callable[[], None] = lambda: None
        self.events = Events(api, FILTERS, self._receive, lambda: self.seen.put_nowait("resumed"))

    def _receive(self, event: Event) -> None:
        self.seen.put_nowait(event["Actor"]["Attributes"]["rce.run"])
        self.on_event()

    async def next(self, count: int) -> list[str]:
        async with asyncio.timeout(60):
            return [await self.seen.get() for _ in range(count)]

    async def ended(self) -> bool:
        await asyncio.to_thread(self.events._thread.join, 60)
        return not self.events._thread.is_alive()


@pytest.fixture(autouse=True)
def no_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RECONNECT_DELAY", 0)


async def test_events_are_delivered_after_the_stream_has_begun() -> None:
    api, before = Api(Stream(event("a"), event("b"))), int(time.time())
    follower = Follower(api)
    follower.events.start()
    assert await follower.next(3) == ["resumed", "a", "b"]
    assert api.asked[0]["filters"] == FILTERS
    assert before <= api.asked[0]["since"] <= time.time()
    follower.events.close()
    assert await follower.ended()


@pytest.mark.parametrize("error", [OSError("connection reset"), docker.errors.APIError("restarting")])
async def test_broken_stream_is_opened_again(error: Exception) -> None:
    """The caller is told, as events may have been lost."""
    follower = Follower(Api(Stream(event("a"), error=error), error, Stream(event("b"))))
    follower.events.start()
    assert await follower.next(4) == ["resumed", "a", "resumed", "b"]
    follower.events.close()
    assert await follower.ended()


async def test_nothing_is_delivered_after_closing() -> None:
    """Not even what the thread has already passed to the event loop."""
    follower = Follower(Api(Stream(event("a"), event("b"), event("c"))))
    follower.on_event = follower.events.close
    follower.events.start()
    assert await follower.next(2) == ["resumed", "a"]
    assert await follower.ended()
    await asyncio.sleep(0)  # what the thread has passed on is handled
    assert follower.seen.empty()


async def test_stream_that_begins_while_closing_is_closed() -> None:
    stream = Stream()
    api = Api(stream)
    follower = Follower(api)
    api.before = follower.events.close
    follower.events.start()
    assert await follower.ended()
    assert stream.closed.is_set()
    assert follower.seen.empty()
