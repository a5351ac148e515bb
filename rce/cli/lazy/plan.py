"""Implementation of `rce plan`: plans on a map of this machine, of a map job or of the knowledge repository."""

from __future__ import annotations

import argparse
import asyncio
import math
import tempfile
from pathlib import Path

from rce.api.map_jobs import MOTION_MODELS
from rce.cli.contexts import Access, running_platform
from rce.cli.session import ConsoleSession
from rce.client.knowledge import KnowledgeClient
from rce.client.map_service import MapServiceClient
from rce.errors import InvalidRequest, NotFound
from rce.mapping.files.maps import read_map
from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.planning.coverage import cover
from rce.planning.files import write_plan
from rce.planning.footprint import Footprint
from rce.planning.hybrid import Vehicle
from rce.planning.planner import PlannerSettings, plan
from rce.planning.search.deadline import Deadline

MAP_FILES = ("map.yaml", "map.pgm")  # of a job, and of an environment to which `rce knowledge add --map` added them


def run(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Plan a path and write it, or publish the map in an environment.

    Raises:
        InvalidRequest: Wrong options, or a map that cannot be read.
        NoPath: There is no path.
    """
    if sum(map(bool, (args.map, args.map_job, args.environment))) != 1:
        raise InvalidRequest("give one map: MAP.yaml, --map-job JOB or --environment UID")
    if args.env:
        asyncio.run(_publish(running_platform(args), args.env, load(args)))
        print(f"the planner of {args.env} has the map")
        return
    if not args.start or bool(args.goal) == args.cover:
        raise InvalidRequest("give --start, and either --goal or --cover")
    settings = settings_of(args)
    start, goal = pose(args.start, "--start"), pose(args.goal or args.start, "--goal")
    grid = load(args)
    costmap = settings.costmap(grid)
    if args.cover:
        with Deadline(args.time) as deadline:
            covered = cover(costmap, start, args.tool, deadline)
        poses, text = covered.poses, f"covers {covered.share:.1%} of what the robot can reach"
    else:
        path = plan(costmap, start, goal, settings)
        poses, text = path.poses, f"{path.length:.2f} m"
    written = write_plan(args.out, grid, costmap, poses)
    print(f"{len(poses)} poses, {text}; path in {args.out}: {', '.join(file.name for file in written)}")


def settings_of(args: argparse.Namespace) -> PlannerSettings:
    """Return the settings of the planner.

    Raises:
        InvalidRequest: A number is out of range, or the footprint is wrong.
    """
    for name, value in (("--radius", args.radius), ("--time", args.time), ("--tool", args.tool)):
        if not 0.0 < value < math.inf:
            raise InvalidRequest(f"{name} is {value:g}; it must be above 0")
    if not 0.0 <= args.tolerance < math.inf:
        raise InvalidRequest(f"--tolerance is {args.tolerance:g}; it must be 0 or more")
    model = next(each for each in MOTION_MODELS if each == args.motion)
    return PlannerSettings(
        planner=args.planner,
        footprint=Footprint.parse(args.footprint),
        allow_unknown=args.allow_unknown,
        tolerance=args.tolerance,
        max_planning_time=args.time,
        vehicle=Vehicle(args.radius, model),
    )


def pose(text: str, option: str) -> Pose:
    """Return the pose of a text X,Y or X,Y,YAW.

    Raises:
        InvalidRequest: The text is not of this form.
    """
    try:
        x, y, theta = (float(part) for part in (text if text.count(",") > 1 else f"{text},0").split(","))
    except ValueError:
        raise InvalidRequest(f"{option} is {text!r}; it must be X,Y or X,Y,YAW in metres and radians") from None
    if not math.isfinite(x + y + theta):
        raise InvalidRequest(f"{option} is {text!r}; its numbers must be finite")
    return Pose(x, y, theta)


def load(args: argparse.Namespace) -> OccupancyGrid:
    """Return the map that the options name, from a file or from a service of the platform.

    Raises:
        NotFound: There is no such map.
        RceError: It cannot be read or fetched.
    """
    if args.map:
        return read_map(Path(args.map))
    access = running_platform(args)
    with tempfile.TemporaryDirectory() as directory:
        for name in MAP_FILES:
            _fetch(access, args, name, Path(directory) / name)
        return read_map(Path(directory) / MAP_FILES[0])


def _fetch(access: Access, args: argparse.Namespace, name: str, path: Path) -> None:
    try:
        if args.map_job:
            maps = MapServiceClient(access.url, user=access.user, password=access.password, key=access.key)
            maps.fetch(args.map_job, name, path)
        else:
            knowledge = KnowledgeClient(access.url, user=access.user, password=access.password, key=access.key)
            knowledge.fetch_file("environment", args.environment, name, path)
    except NotFound as error:
        raise NotFound(f"{error}: a map in the plane has the files {' and '.join(MAP_FILES)}") from None


async def _publish(access: Access, environment: str, grid: OccupancyGrid) -> None:
    from rce.mapping.publication import publish_map  # its types take a while to load

    await publish_map(access.url, access.user, access.password, access.key, environment, grid)
