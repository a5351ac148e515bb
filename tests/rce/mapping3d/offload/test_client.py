from __future__ import annotations

from typing import cast

import pytest

from rce.client import Environment, Reconnected, Robot
from rce.errors import Died
from rce.mapping3d.evaluation.room import QVGA
from rce.mapping3d.offload.client import RgbdRobot
from rce.protocol.messages import NodeEvent
from tests.support.cloud_mapper import CloudMapper
from tests.support.rgbd import CLEAN, simulated


def client(cloud: CloudMapper) -> RgbdRobot:
    return RgbdRobot(cast(Robot, cloud), cast(Environment, cloud), QVGA, rate=1e12)


@pytest.mark.slow
async def test_key_frames_go_up_and_corrections_come_back() -> None:
    cloud = CloudMapper()
    async with client(cloud) as robot:
        for frame in simulated(0.4, 2.0, CLEAN):
            await robot.add(frame)
        await robot.finish()
        assert len(cloud.shared.mapper.store) == robot.tracking.key_frames > 1
        newest = cloud.shared.poses("robot")[-1]
        assert robot.tracking.key_pose(newest.index)[0, 3] == pytest.approx(newest.pose[0, 3])
        files = await robot.files()
    assert files["cloud.ply"].startswith(b"ply")
    assert len(files["mesh.ply"]) > 100_000, "a file of several pieces is complete"
    cloud.shared.close()


@pytest.mark.slow
async def test_nothing_is_lost_and_nothing_doubled_by_a_cut_line() -> None:
    cloud, frames = CloudMapper(), list(simulated(0.6, 2.0, CLEAN))
    async with client(cloud) as robot:
        for number, frame in enumerate(frames):
            cloud.cut = 4 <= number < 12
            located = await robot.add(frame)
            assert not located.tracked.lost
        cloud.events_stream.put(Reconnected(True))
        await robot.finish()
        assert len(cloud.shared.mapper.store) == robot.tracking.key_frames
    cloud.shared.close()


async def test_error_of_sending_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> bytes:
        raise TypeError("this cannot be sent")

    cloud = CloudMapper()
    monkeypatch.setattr("rce.mapping3d.offload.client.image_cdr", broken)
    async with client(cloud) as robot:
        await robot.add(next(iter(simulated(0.1, faults=CLEAN))))
        with pytest.raises(TypeError, match="cannot be sent"):
            await robot.settle()
    cloud.shared.close()


async def test_end_of_the_mapper_ends_the_wait() -> None:
    cloud = CloudMapper()
    async with client(cloud) as robot:
        cloud.cut = True
        await robot.add(next(iter(simulated(0.1, faults=CLEAN))))
        cloud.events_stream.put(NodeEvent("brain", "mapper", 1, ["no memory"]))
        with pytest.raises(Died, match="no memory"):
            await robot.settle()
    cloud.shared.close()
