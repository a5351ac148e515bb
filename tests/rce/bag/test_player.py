"""Player of recordings: intervals, pause, speed, jumps, the end."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from rce.bag.playback import PlaybackRequest
from rce.bag.player import Player
from rce.bag.reader import Recorded, summarize
from rce.bag.writer import BagWriter, Topic

START = 1_000_000_000_000
STRING = Topic("/say", "std_msgs/msg/String", "string data\n")


class Stage:
    """A player of five messages, a second apart, and a clock that the test turns."""

    def __init__(self, path: Path, loop: bool = False) -> None:
        writer = BagWriter(path)
        for number in range(5):
            writer.put(STRING, number.to_bytes(4), START + number * 1_000_000_000)
        writer.close({})
        self.now = 0.0
        self.played: list[int] = []
        self.player = Player(path, summarize(path), self._publish, loop=loop, now=lambda: self.now)
        self.task: asyncio.Task[None] | None = None

    async def _publish(self, message: Recorded) -> None:
        self.played.append(int.from_bytes(message.cdr))

    async def begin(self, until_end: bool = False) -> asyncio.Task[None]:
        self.task = asyncio.create_task(self.player.run(until_end))
        await self.until(lambda: self.player._status == "playing")
        return self.task

    async def at(self, now: float, *played: int) -> None:
        """Turn the clock, and wait until these messages were played."""
        self.now = now
        await self.until(lambda: self.played == list(played))

    async def until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(30):
            while not condition():
                self.player._woken.set()  # the clock was turned
                await asyncio.sleep(0)


@pytest.fixture
async def stage(tmp_path: Path) -> AsyncIterator[Stage]:
    stage = Stage(tmp_path / "a.mcap")
    yield stage
    if stage.task is not None:
        stage.task.cancel()


async def test_messages_are_played_at_their_intervals(stage: Stage) -> None:
    task = await stage.begin(until_end=True)
    await stage.at(0.9, 0)
    await stage.at(2.1, 0, 1, 2)
    assert stage.player.time == START + 2_100_000_000
    await stage.at(4.0, 0, 1, 2, 3, 4)
    await asyncio.wait_for(task, 30)
    state = stage.player.take_state()
    assert (state.status, state.time, state.end) == ("ended", START + 4_000_000_000, START + 4_000_000_000)


async def test_pause_and_speed_change_when_messages_are_played(stage: Stage) -> None:
    await stage.begin()
    await stage.at(1.0, 0, 1)
    stage.player.control(PlaybackRequest(False, id="p"))
    state = stage.player.take_state()
    assert (state.status, state.request, state.seeked) == ("paused", "p", False)
    assert stage.player.take_state().request == ""
    await stage.at(100.0, 0, 1)
    stage.player.control(PlaybackRequest(True, 2.0))
    await stage.at(100.6, 0, 1, 2)
    await stage.at(101.5, 0, 1, 2, 3, 4)


async def test_jumps_go_forth_and_back_also_while_paused(stage: Stage) -> None:
    await stage.begin()
    await stage.at(0.0, 0)
    stage.player.control(PlaybackRequest(True, seek=START + 3_000_000_000))
    assert stage.player.take_state().seeked
    await stage.at(0.0, 0, 3)
    stage.player.control(PlaybackRequest(False, seek=START - 5))
    await stage.at(50.0, 0, 3)
    assert stage.player.time == START
    stage.player.control(PlaybackRequest(True))
    await stage.at(50.0, 0, 3, 0)


async def test_playback_that_has_ended_is_played_again(stage: Stage) -> None:
    await stage.begin()
    await stage.at(4.0, 0, 1, 2, 3, 4)
    await stage.until(lambda: stage.player.take_state().status == "ended")
    stage.player.control(PlaybackRequest(True))
    await stage.at(4.0, 0, 1, 2, 3, 4, 0)


async def test_loop_begins_again(tmp_path: Path) -> None:
    stage = Stage(tmp_path / "a.mcap", loop=True)
    task = await stage.begin()
    await stage.at(4.0, 0, 1, 2, 3, 4, 0)
    task.cancel()
