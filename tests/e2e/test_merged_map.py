"""Three robots whose starts nobody knows build one map together, in a real platform, while they drive."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Sequence
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from real_platform import RealPlatform

from rce.client import Stream
from rce.mapping.graph_mapper import GraphMapper
from rce.mapping.recordings import open_recording
from rce.mapping.robot import MappingRobot, Result, start_node
from rce.mapping.scans import Scan
from rce.mapping.trials import error_of, read_relations

DATA = Path(os.environ.get("RCE_DATA", Path(__file__).parents[3] / "shared" / "data"))
LOG = DATA / "mit-csail.clf.gz"
POSE = "geometry_msgs/PoseWithCovarianceStamped"
EVERY = 2  # scans: half the time, and the same errors
PARTS = {"ann": slice(0, 450), "bob": slice(300, 750), "cid": slice(600, 994)}
SHARED = 150  # scans of two parts
SAME = 0.1  # metres, mean, between where two robots say that both were at the same scans
SEEN = 0.5  # metres between where a robot is told to be at its last scan and where it was by all that all have seen

pytestmark = pytest.mark.skipif(not LOG.exists(), reason=f"needs {LOG.name} in {DATA}, or RCE_DATA")


class Driven(NamedTuple):
    """`told`: x and y (2,) of the pose by which the last scan was answered."""

    result: Result
    told: NDArray[np.float64]


async def test_three_parts_of_a_building_become_one_map(platform: RealPlatform) -> None:
    """Its error is at most 1.5 times that of one robot that was everywhere; all three get it, and where they are in it,
    which they are told while they drive."""
    scans = list(open_recording(LOG))[::EVERY]
    alone = asyncio.create_task(asyncio.to_thread(error_alone, scans))
    team = await drive(platform, {name: scans[part] for name, part in PARTS.items()})
    first, *others = (each.result.grid.cells for each in team.values())
    assert all(np.array_equal(first, each) for each in others)
    ways = {name: each.result.trajectory for name, each in team.items()}
    assert off_by(ways["ann"], ways["bob"]) < SAME
    assert off_by(ways["bob"], ways["cid"]) < SAME
    for name, each in team.items():
        assert np.hypot(*(each.told - ways[name][-1, 1:3])) < SEEN, f"{name} was not told where it is on the one map"
    assert error(np.concatenate([*ways.values()])) <= 1.5 * await alone


async def drive(platform: RealPlatform, parts: dict[str, list[Scan]]) -> dict[str, Driven]:
    """Each robot drives its part, all at the same time."""
    async with AsyncExitStack() as stack:
        robots = {name: await stack.enter_async_context(platform.robot(f"team_{name}")) for name in parts}
        owner = await stack.enter_async_context(platform.robot("team_owner"))
        shared = await stack.enter_async_context(owner.environment("team", restart="no"))
        await start_node(shared, "team", {"robots": [*parts]})
        team = {
            name: await stack.enter_async_context(MappingRobot(robot, robot.environment("team"), f"/{name}"))
            for name, robot in robots.items()
        }
        await asyncio.gather(*(each.wire() for each in team.values()))
        poses = {name: await shared.subscriber(f"/{name}/pose", POSE, depth=1) for name in parts}
        await asyncio.gather(*(team[name].drive(part, lambda _: None) for name, part in parts.items()))
        told = {name: await told_at(poses[name], part[-1].stamp) for name, part in parts.items()}
        return {name: Driven(await each.result(), told[name]) for name, each in team.items()}


async def told_at(poses: Stream[Any], stamp: float) -> NDArray[np.float64]:
    """x and y (2,) of the pose of this stamp, or of the first one after it."""
    async with asyncio.timeout(30):
        async for message in poses:
            time, pose = message["header"]["stamp"], message["pose"]["pose"]["position"]
            if time["sec"] + time["nanosec"] / 1e9 > stamp - 1e-3:
                return np.array([pose["x"], pose["y"]])
    raise AssertionError("the poses ended")


def off_by(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Metres, mean, between the poses that two trajectories have for the same stamps."""
    _, one, two = np.intersect1d(first[:, 0], second[:, 0], return_indices=True)
    assert len(one) == SHARED
    return float(np.hypot(*(first[one, 1:3] - second[two, 1:3]).T).mean())


def error(trajectory: NDArray[np.float64]) -> float:
    """Metres; of several robots, rows of all."""
    ordered = trajectory[np.argsort(trajectory[:, 0], kind="stable")]
    return error_of(ordered, read_relations(DATA / "mit-csail.relations", ordered[:, 0])).translation


def error_alone(scans: Sequence[Scan]) -> float:
    mapper = GraphMapper()
    for scan in scans:
        mapper.add(scan)
    return error(mapper.trajectory())
