"""`plan` and `localise`: paths and poses on maps."""

from __future__ import annotations

from pathlib import Path

from rce.api.map_jobs import MOTION_MODELS, PLANNERS
from rce.cli.arguments import RUNNING, argument
from rce.cli.command import Command, Lazy, Section
from rce.cli.commands.maps import ODOMETRY_TOPIC, SCAN_TOPIC

COMMANDS = (
    Command(
        "plan",
        "Plan a path on a map, or one that covers it.",
        Lazy("rce.cli.lazy.plan", "run"),
        (
            argument("map", nargs="?", metavar="MAP.yaml", help="map as `rce map` and map_server write it"),
            argument("--start", default="", metavar="X,Y[,YAW]", help="metres and radians, map frame"),
            argument("--goal", default="", metavar="X,Y[,YAW]", help="metres and radians, map frame"),
            argument("--planner", choices=PLANNERS, default=PLANNERS[0], help="(default: %(default)s)"),
            argument(
                "--footprint",
                default="0.2",
                metavar="RADIUS|CORNERS",
                help="radius, or corners as [[0.3,0.2],[0.3,-0.2],[-0.3,0]]; metres (default: %(default)s)",
            ),
            argument("--radius", type=float, default=0.4, metavar="METRES", help="of turns (default: %(default)s)"),
            argument(
                "--motion", choices=MOTION_MODELS, default=MOTION_MODELS[0], help="of hybrid (default: %(default)s)"
            ),
            argument("--allow-unknown", action="store_true", help="unknown space is free"),
            argument("--tolerance", type=float, default=0.125, metavar="METRES", help="(default: %(default)s)"),
            argument("--time", type=float, default=2.0, metavar="SECONDS", help="at most (default: %(default)s)"),
            argument("--cover", action="store_true", help="cover all that the robot reaches from --start"),
            argument("--tool", type=float, default=0.4, metavar="METRES", help="width covered (default: %(default)s)"),
            argument("--out", type=Path, default=Path("plan"), metavar="DIR", help="(default: %(default)s)"),
            argument("--map-job", default="", metavar="JOB", help="take the map of a job of the map service"),
            argument(
                "--environment",
                default="",
                metavar="UID",
                help="take the map of this entry of the repository",
            ),
            argument(
                "--env",
                completion="environment",
                default="",
                metavar="ENV",
                help="publish the map on /map of this environment, for its planner node, and plan nothing",
            ),
        ),
        (
            "plan map/map.yaml --start 0,0 --goal 5,2",
            "plan map/map.yaml --start 0,0,0 --goal 5,2,1.57 --planner hybrid",
            "plan map/map.yaml --start 0,0 --cover --tool 0.5",
        ),
        platform=RUNNING,
        section=Section.LOCAL,
        description="Writes path.csv and path.png. A platform is needed for --map-job, --environment and --env only.",
    ),
    Command(
        "localise",
        "Localise a recording in a map, without or with an initial pose.",
        Lazy("rce.cli.lazy.localise", "run"),
        (
            argument("map", type=Path, metavar="MAP.yaml", help="map as `rce map` and map_server write it"),
            argument("recording", type=Path, metavar="FILE", help="CARMEN log, ROS 1 or ROS 2 bag"),
            argument("--start", default="", metavar="X,Y[,YAW]", help="initial pose; else the whole map is searched"),
            argument("--out", type=Path, default=Path("localised"), metavar="DIR", help="(default: %(default)s)"),
            SCAN_TOPIC,
            ODOMETRY_TOPIC,
        ),
        ("localise map/map.yaml monday.bag",),
        platform=None,
        section=Section.LOCAL,
        description="Writes trajectory.txt and map.png.",
    ),
)
