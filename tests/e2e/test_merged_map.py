"""Three robots with unknown start poses build one map together while they drive, in a real platform."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import AsyncExitStack
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from rce.client import Stream
from rce.mapping.evaluation.trials import error_of, read_relations
from rce.mapping.files.recordings import open_recording
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.robot import MappingRobot, Result, start_node
from rce.mapping.scans import Scan
from tests.support.e2e.real_platform import RealPlatform
from tests.support.paths import DATA

LOG = DATA / "mit-csail.clf.gz"
POSE = "geometry_msgs/PoseWithCovarianceStamped"
EVERY = 2  # every second scan takes half the time, with the same errors
PARTS = {"ann": slice(0, 450), "bob": slice(300, 750), "cid": slice(600, 994)}
SHARED = 150  # scans of two parts
AGREEMENT = 0.1  # metres, mean, between poses of two robots for the same scans
POSE_ERROR = 0.5  # metres between the pose sent for the last scan and the final one

pytestmark = pytest.mark.skipif(not LOG.exists(), reason=f"needs {LOG.name} in {DATA}, or RCE_DATA")


class Driven(NamedTuple):
    """Result of one robot. `position` is x and y (2,) in metres of the pose sent for its last scan."""

    result: Result
    position: NDArray[np.float64]


async def test_three_robots_build_one_map(platform: RealPlatform) -> None:
    """All robots get the same map and their poses in it while they drive.

    Its error is at most 1.5 times that of one robot that drives everything.
    """
    scans = list(open_recording(LOG))[::EVERY]
    alone = asyncio.create_task(asyncio.to_thread(error_alone, scans))
    team = await drive(platform, {name: scans[part] for name, part in PARTS.items()})
    first, *others = (each.result.grid.cells for each in team.values())
    assert all(np.array_equal(first, each) for each in others)
    ways = {name: each.result.trajectory for name, each in team.items()}
    assert mean_distance(ways["ann"], ways["bob"]) < AGREEMENT
    assert mean_distance(ways["bob"], ways["cid"]) < AGREEMENT
    for name, each in team.items():
        assert np.hypot(*(each.position - ways[name][-1, 1:3])) < POSE_ERROR, (
            f"{name} did not get its pose in the common map"
        )
    assert error(np.concatenate([*ways.values()])) <= 1.5 * await alone


async def drive(platform: RealPlatform, parts: dict[str, list[Scan]]) -> dict[str, Driven]:
    """Let each robot drive its part, all at the same time."""
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
        positions = {name: await position_at(poses[name], part[-1].stamp) for name, part in parts.items()}
        return {name: Driven(await each.result(), positions[name]) for name, each in team.items()}


async def position_at(poses: Stream[Any], stamp: float) -> NDArray[np.float64]:
    """Return x and y (2,) of the pose of this stamp, or of the first one after it."""
    async with asyncio.timeout(60):
        async for message in poses:
            time, pose = message["header"]["stamp"], message["pose"]["pose"]["position"]
            if time["sec"] + time["nanosec"] / 1e9 > stamp - 1e-3:
                return np.array([pose["x"], pose["y"]])
    raise AssertionError("the poses ended")


def mean_distance(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Return the mean distance in metres between poses of two trajectories with the same stamps."""
    _, one, two = np.intersect1d(first[:, 0], second[:, 0], return_indices=True)
    assert len(one) == SHARED
    return float(np.hypot(*(first[one, 1:3] - second[two, 1:3]).T).mean())


def error(trajectory: NDArray[np.float64]) -> float:
    """Return the error in metres of a trajectory, which may have rows of several robots."""
    ordered = trajectory[np.argsort(trajectory[:, 0], kind="stable")]
    return error_of(ordered, read_relations(DATA / "mit-csail.relations", ordered[:, 0])).translation


def error_alone(scans: Sequence[Scan]) -> float:
    """Return the error of one robot that drives everything."""
    mapper = GraphMapper()
    for scan in scans:
        mapper.add(scan)
    return error(mapper.trajectory())
