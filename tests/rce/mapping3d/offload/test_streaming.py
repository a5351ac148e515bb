from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import cast

import pytest

from rce.client import Environment, Reconnected, Robot
from rce.mapping3d.evaluation.room import QVGA
from rce.mapping3d.offload.streaming import WINDOW, StreamingRobot
from rce.mapping3d.offload.streams import Format
from tests.support.cloud_mapper import CloudMapper
from tests.support.rgbd import CLEAN, simulated

FRAMES = list(simulated(0.5, faults=CLEAN))


def streaming(cloud: CloudMapper, format: Format = "jpeg") -> StreamingRobot:
    return StreamingRobot(cast(Robot, cloud), cast(Environment, cloud), QVGA, format=format)


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(30.0):
        while not condition():  # noqa: ASYNC110  # the client tells of poses by an attribute
            await asyncio.sleep(0.005)


async def test_each_frame_goes_up_and_its_pose_comes_back() -> None:
    cloud = CloudMapper()
    async with streaming(cloud) as robot:
        for frame in FRAMES[:4]:
            assert await robot.add(frame)
            await until(lambda: not robot._unanswered)
            assert robot.last is not None
            assert robot.last.stamp == pytest.approx(frame.stamp, abs=1e-6)
    assert cloud.received == 4
    assert robot.last is not None
    assert not robot.last.lost
    assert robot.sent > 0


async def test_frames_are_dropped_where_the_cloud_falls_behind_and_go_on_after_it() -> None:
    cloud = CloudMapper()
    cloud.mute = True
    async with streaming(cloud) as robot:
        sent = [await robot.add(frame) for frame in FRAMES[: WINDOW + 2]]
        assert sent == [True] * WINDOW + [False] * 2
        assert robot.dropped == 2
        cloud.mute = False
        cloud.events_stream.put(Reconnected(True))
        await asyncio.sleep(0)
        await until(lambda: not robot._unanswered)
        assert await robot.add(FRAMES[-1])
        await until(lambda: robot.last is not None)


async def test_lost_frame_of_video_is_followed_by_a_key_frame() -> None:
    pytest.importorskip("av", reason="needs the extra `video`")
    cloud = CloudMapper()
    async with streaming(cloud, "h264") as robot:
        await robot.add(FRAMES[0])
        cloud.cut = True
        await robot.add(FRAMES[1])
        cloud.cut = False
        await robot.add(FRAMES[2])
        await until(lambda: robot.last is not None and robot.last.lost)
        await robot.add(FRAMES[3])
        await until(lambda: robot.last is not None and not robot.last.lost)
