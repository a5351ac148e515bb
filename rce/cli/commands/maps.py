"""`map`, and `map submit|status|fetch|cancel`, `job`: maps of recorded laser scans."""

from __future__ import annotations

from pathlib import Path

from rce.api.map_jobs import KINDS
from rce.api.map_jobs import MAPPERS as SERVICE_MAPPERS
from rce.cli.arguments import JSON, RUNNING, RUNNING_OR_OWN, argument
from rce.cli.command import Command, Lazy, Section

MAPPERS = ("graph", "particle")
"""Names in rce.mapping.mappers, whose import compiles all kernels."""

SCAN_TOPIC = argument("--scan-topic", default="", help="of a bag with several topics of laser scans or clouds")
ODOMETRY_TOPIC = argument("--odometry-topic", default="", help="of a bag with several topics of odometry")
HEIGHTS = argument(
    "--heights",
    default="-0.3,0.3",
    metavar="LOW,HIGH",
    help="metres above a lidar between which scans are cut from clouds, in a bag without scans (default: %(default)s)",
)
RESOLUTION = argument(
    "--resolution", type=float, default=0.05, metavar="METRES", help="side of a cell (default: %(default)s)"
)
OUT = argument(
    "--out", type=Path, default=Path("map"), metavar="DIR", help="for the map's files (default: %(default)s)"
)
PARALLEL = argument(
    "--parallel",
    type=int,
    default=1,
    metavar="N",
    help="workers, each in an environment of its own; recordings that overlap become one map (default: %(default)s)",
)
JOBS_JSON = argument("--json", action="store_true", help="print jobs as JSON")
JOB = argument("job", metavar="JOB", help="its id")

COMMANDS = (
    Command(
        "map",
        "Make a map of recorded laser scans.",
        Lazy("rce.cli.lazy.map", "run"),
        (
            argument("recordings", nargs="*", type=Path, metavar="FILE", help="CARMEN log, ROS 1 or ROS 2 bag"),
            argument("--simulate", action="store_true", help="map a robot simulated in a floor plan instead"),
            OUT,
            RESOLUTION,
            argument("--mapper", choices=MAPPERS, default="graph", help="(default: %(default)s); see docs/mapping.md"),
            argument("--particles", type=int, default=30, help="of the mapper `particle` (default: %(default)s)"),
            argument("--seed", type=int, default=0, help="of the mapper `particle` (default: %(default)s)"),
            argument(
                "--team",
                action="store_true",
                help="replay all FILEs at the same time, each as a robot of its own, into one joint map",
            ),
            PARALLEL,
            SCAN_TOPIC,
            ODOMETRY_TOPIC,
            HEIGHTS,
        ),
        (
            "map corridor.log --out corridor",
            "map --simulate",
            "map --team first.bag second.bag",
            "map --parallel 4 *.log.gz",
        ),
        platform=RUNNING_OR_OWN,
        section=Section.LOCAL,
        description="Sends the scans through a platform to its mapping node and writes the map that comes back. "
        "`rce map submit`, `status`, `fetch` and `cancel` have the map service of a platform do this instead.",
    ),
    Command(
        "map submit",
        "Upload recordings and submit a job of the map service for each, or with --parallel one for all.",
        Lazy("rce.cli.lazy.map_jobs", "submit"),
        (
            argument("recordings", nargs="+", type=Path, metavar="FILE", help="CARMEN log, ROS 1 or ROS 2 bag"),
            argument(
                "--kind",
                choices=KINDS,
                default=KINDS[0],
                help="3d: bags of cameras with depth or of lidars (default: %(default)s)",
            ),
            argument("--mapper", choices=SERVICE_MAPPERS, default=SERVICE_MAPPERS[0], help="(default: %(default)s)"),
            RESOLUTION,
            argument(
                "--max-range",
                type=float,
                default=30.0,
                metavar="METRES",
                help="ignore longer ranges (default: %(default)s)",
            ),
            PARALLEL,
            SCAN_TOPIC,
            ODOMETRY_TOPIC,
            argument("--wait", action="store_true", help="wait for the maps and fetch them"),
            OUT,
            JOBS_JSON,
        ),
        ("map submit corridor.log --wait", "map submit --parallel 4 monday.bag tuesday.bag"),
        platform=RUNNING,
        section=Section.LOCAL,
    ),
    Command(
        "map status",
        "Show your jobs, or one of them.",
        Lazy("rce.cli.lazy.map_jobs", "status"),
        (argument("job", nargs="?", metavar="JOB", help="its id"), JOBS_JSON),
        platform=RUNNING,
        section=Section.LOCAL,
    ),
    Command(
        "map fetch",
        "Wait for the end of a job and fetch its files.",
        Lazy("rce.cli.lazy.map_jobs", "fetch"),
        (JOB, OUT),
        platform=RUNNING,
        section=Section.LOCAL,
    ),
    Command(
        "map cancel",
        "Cancel a job.",
        Lazy("rce.cli.lazy.map_jobs", "cancel"),
        (JOB, JOBS_JSON),
        platform=RUNNING,
        section=Section.LOCAL,
    ),
    Command(
        "job list",
        "List your jobs of the map service.",
        Lazy("rce.cli.lazy.map_jobs", "job_list"),
        (JSON,),
        ("job list",),
    ),
)
