"""`rce bench control` with a platform of its own."""

from __future__ import annotations

from collections import Counter

from rce.bench.control import FLOOR_SAMPLES, NODES
from tests.support.e2e.bench import bench


async def test_each_kind_is_measured_for_each_number_of_robots() -> None:
    phases = (await bench(400, "control", "--robots", "1,2", "--count", "2"))["phases"]
    assert Counter((phase["robots"], phase["kind"], len(phase["seconds"])) for phase in phases) == Counter(
        {(0, kind, FLOOR_SAMPLES): 1 for kind in ("bare Perspective Broker call", "bare SQLite transaction")}
        | {
            (robots, kind, robots * each): 1
            for robots in (1, 2)
            for kind, each in {
                "log in by password": 2,
                "log in by key": 2,
                "create environment": 1,
                "add node": NODES,
                "add interface": 4,
                "connect": 2,
                "disconnect": 2,
                "remove interface": 4,
                "remove node": NODES,
                "destroy environment": 1,
                "add interfaces, 4 a frame": 1,
                "connect, 2 a frame": 1,
                "disconnect, 2 a frame": 1,
                "remove interfaces, 4 a frame": 1,
            }.items()
        }
    )
