"""Three robots whose starts nobody knows build one map together, in a real platform, while they drive."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Sequence
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

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
from rce.messages import Qos

DATA = Path(os.environ.get("RCE_DATA", Path(__file__).parents[3] / "shared" / "data"))
LOG = DATA / "mit-csail.clf.gz"
PARTS = {"ann": slice(0, 900), "bob": slice(600, 1500), "cid": slice(1200, 1988)}
SAME = 0.1  # metres, mean, between where two robots say that both were at the same scans
LATCHED = Qos(reliability="reliable", durability="transient_local", depth=1)

pytestmark = pytest.mark.skipif(not LOG.exists(), reason=f"needs {LOG.name} in {DATA}, or RCE_DATA")


async def test_three_parts_of_a_building_become_one_map(platform: RealPlatform) -> None:
    """Its error is at most 1.5 times that of one robot that was everywhere, and all three get it, and where they are."""
    scans = list(open_recording(LOG))
    alone = asyncio.create_task(asyncio.to_thread(error_alone, scans))
    results, joined = await drive(platform, {name: scans[part] for name, part in PARTS.items()})
    assert joined < len(scans), f"not all were joined while they drove, but after {joined} scans"
    cells = [result.grid.cells for result in results.values()]
    assert all(np.array_equal(each, cells[0]) for each in cells)
    rows = {name: result.trajectory for name, result in results.items()}
    for first, second in (("ann", "bob"), ("bob", "cid")):
        assert off_by(rows[first], rows[second]) < SAME
    assert error(np.concatenate([*rows.values()])) <= 1.5 * await alone


async def drive(platform: RealPlatform, parts: dict[str, list[Scan]]) -> tuple[dict[str, Result], int]:
    """Each robot drives its part; what each gets, and how many scans had been answered when all were in one team."""
    answered = dict.fromkeys(parts, 0)
    async with AsyncExitStack() as stack:
        robots = {name: await stack.enter_async_context(platform.robot(f"team_{name}")) for name in parts}
        owner = next(iter(robots.values()))
        shared = await stack.enter_async_context(owner.environment("team", restart="no"))
        await start_node(shared, "team", {"robots": [*parts]})
        told = await shared.subscriber("/ann/team", "std_msgs/String", qos=LATCHED, depth=100)
        team = {
            name: await stack.enter_async_context(MappingRobot(robot, robot.environment("team"), f"/{name}"))
            for name, robot in robots.items()
        }
        await asyncio.gather(*(each.wire() for each in team.values()))
        complete = asyncio.create_task(all_are_in(told, [*parts], answered))
        await asyncio.gather(*(team[name].drive(part, counter(answered, name)) for name, part in parts.items()))
        results = await asyncio.gather(*(each.result() for each in team.values()))
        return dict(zip(parts, results, strict=True)), await asyncio.wait_for(complete, 30)


def counter(answered: dict[str, int], name: str) -> Any:
    return lambda count: answered.update({name: count})


async def all_are_in(told: Stream[Any], names: Sequence[str], answered: dict[str, int]) -> int:
    async for message in told:
        if json.loads(message["data"]) == names:
            break
    return sum(answered.values())


def off_by(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Metres, mean, between the poses that two trajectories have for the same stamps."""
    _, one, two = np.intersect1d(first[:, 0], second[:, 0], return_indices=True)
    assert len(one) == 300
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
