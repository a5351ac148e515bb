"""Player of recordings: messages at the intervals at which they arrived, with pause, speed and jumps."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Iterator
from contextlib import aclosing, suppress
from itertools import islice
from pathlib import Path

from rce.bag.playback import PlaybackRequest, PlaybackState, Status
from rce.bag.reader import Recorded, Summary, read_since

MAX_SPEED = 1000.0
BATCH = 64  # messages that are read at once, in a thread, while those before them are played

Publish = Callable[[Recorded], Awaitable[None]]


class Player:
    """Player of one recording.

    Attributes:
        changed: Set at each change of the state, for who tells others of it.
    """

    def __init__(
        self,
        path: Path,
        summary: Summary,
        publish: Publish,
        speed: float = 1.0,
        loop: bool = False,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare to play from the beginning.

        Args:
            path: The recording.
            summary: Its summary.
            publish: Publishes a message.
            speed: Speed; 1 is that of the recording.
            loop: Begin again at the end.
            now: The clock, in seconds.
        """
        self.changed = asyncio.Event()
        self._path = path
        self._summary = summary
        self._publish = publish
        self._loop = loop
        self._now = now
        self._speed = speed
        self._status: Status = "paused"
        self._position = summary.start  # time of the recording at `_since`
        self._since = now()
        self._request = ""
        self._seeked = False
        self._jump: int | None = None  # time from which to go on
        self._woken = asyncio.Event()

    @property
    def time(self) -> int:
        """Time of the recording, in ns since 1970."""
        if self._status != "playing":
            return self._position
        passed = int((self._now() - self._since) * self._speed * 1e9)
        return min(self._position + passed, self._summary.end)

    def take_state(self) -> PlaybackState:
        """Return the present state; only the first one after a request names that."""
        bounds = (self._summary.start, self._summary.end)
        state = PlaybackState(self._status, self.time, self._speed, *bounds, self._request, self._seeked)
        self._request, self._seeked = "", False
        self.changed.clear()
        return state

    def control(self, request: PlaybackRequest) -> None:
        """Play or pause, at a speed, perhaps from another time on; at the end, play again."""
        position = self.time
        if request.seek is not None:
            self._jump = max(self._summary.start, min(request.seek, self._summary.end))
        elif request.play and position >= self._summary.end:
            self._jump = self._summary.start
        self._seeked = self._jump is not None
        self._request = request.id
        self._speed = min(max(request.speed, 1 / MAX_SPEED), MAX_SPEED)
        self._set("playing" if request.play else "paused", position if self._jump is None else self._jump)
        self._woken.set()

    async def run(self, until_end: bool) -> None:
        """Play until cancelled, or until the end."""
        since = self._summary.start
        self._set("playing", since)
        while True:
            jump = await self._play(since)
            if jump is None and self._loop:
                jump = self._summary.start
                self._set("playing", jump)
            elif jump is None:
                self._set("ended", self._summary.end)
                if until_end:
                    return
                while jump is None:
                    await self._wait(None)
                    jump = self._take_jump()
            since = jump

    def _set(self, status: Status, position: int) -> None:
        self._status, self._position, self._since = status, position, self._now()
        self.changed.set()

    def _take_jump(self) -> int | None:
        jump, self._jump = self._jump, None
        return jump

    async def _play(self, since: int) -> int | None:
        """Play what is recorded from a time on; return the time of a jump, or None at the end."""
        messages = _batched(read_since(self._path, since if since > self._summary.start else 0))
        async with aclosing(messages):
            async for each in messages:
                while self._jump is None and ((pause := self._pause_before(each)) is None or pause > 0):
                    await self._wait(pause)
                if (jump := self._take_jump()) is not None:
                    return jump
                await self._publish(each)
        return self._take_jump()

    def _pause_before(self, message: Recorded) -> float | None:
        """Return the seconds until a message is due; None while it is paused."""
        if self._status != "playing":
            return None
        return (message.time - self._position) / 1e9 / self._speed - (self._now() - self._since)

    async def _wait(self, seconds: float | None) -> None:
        """Wait for some seconds, or for the next request."""
        self._woken.clear()
        with suppress(TimeoutError):
            await asyncio.wait_for(self._woken.wait(), seconds)


async def _batched(messages: Iterator[Recorded]) -> AsyncGenerator[Recorded, None]:
    """Yield messages, which a thread reads ahead."""

    def read() -> list[Recorded]:
        return list(islice(messages, BATCH))

    batch = await asyncio.to_thread(read)
    while batch:
        coming = asyncio.ensure_future(asyncio.to_thread(read))
        try:
            for each in batch:
                yield each
        finally:
            batch = await coming
