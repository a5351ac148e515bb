"""`python -P -m rce.mapservice.plan_program`: plans one path, in a process of its own.

The service has neither maps nor compilers in its memory, and a plan that takes too long is killed. The process reads
the task as JSON from standard input, and writes the answer as JSON to standard output.
"""

from __future__ import annotations

import os
import resource
import sys
from pathlib import Path

import msgspec
from msgspec import Struct

from rce.api.map_jobs import Plan, PlanPose, PlanRequest, Waypoint
from rce.errors import ErrorInfo, RceError

MAX_MEMORY = 4 * 1024**3  # bytes
NICENESS = 5


class PlanTask(Struct, frozen=True):
    """Path to plan on the map that a YAML file of map_server describes."""

    map: str
    request: PlanRequest


class PlanAnswer(Struct, frozen=True, omit_defaults=True):
    """The path, or the reason why there is none."""

    plan: Plan | None = None
    error: ErrorInfo | None = None


def work(task: PlanTask) -> Plan:
    """Plan the path.

    Raises:
        NoPath: There is none.
        RceError: The map cannot be read, or the request is wrong.
    """
    from rce.mapping.files.maps import read_map
    from rce.mapping.geometry import Pose
    from rce.planning.planner import PlannerSettings, plan

    def pose(wanted: PlanPose) -> Pose:
        return Pose(wanted.x, wanted.y, wanted.theta)

    settings = PlannerSettings.of(task.request)
    costmap = settings.costmap(read_map(Path(task.map)))
    path = plan(costmap, pose(task.request.start), pose(task.request.goal), settings)
    rows = path.poses.round(4).tolist()
    poses = [Waypoint(x, y, theta, int(direction)) for x, y, theta, direction in rows]
    return Plan(poses, round(path.length, 4), round(path.seconds, 4))


def main() -> int:
    """Run the program and return its exit status."""
    resource.setrlimit(resource.RLIMIT_DATA, (MAX_MEMORY, MAX_MEMORY))
    os.nice(NICENESS)
    task = msgspec.json.decode(sys.stdin.buffer.read(), type=PlanTask)
    try:
        answer = PlanAnswer(work(task))
    except RceError as error:
        answer = PlanAnswer(error=error.info)
    sys.stdout.buffer.write(msgspec.json.encode(answer))
    return 0


if __name__ == "__main__":
    sys.exit(main())
