"""`bench`: measurements of a platform."""

from __future__ import annotations

import tempfile
from pathlib import Path

from rce import __version__
from rce.api.map_jobs import MAPPERS
from rce.cli.arguments import ENGINES, RUNNING_OR_OWN, Argument, argument
from rce.cli.command import Command, Group, Lazy, Section

QUICK_SIZES, QUICK_SAMPLES = 4, 3
MODULE, SCALE, MAPS = "rce.cli.lazy.bench", "rce.cli.lazy.bench_scale", "rce.cli.lazy.bench_maps"

SAMPLES_JSON = argument("--json", action="store_true", help="print every sample as JSON instead of a table")
FIGURES_JSON = argument("--json", action="store_true", help="print the figures as JSON")
ENGINE = argument("--engine", choices=ENGINES, default="process", help="(default: %(default)s)")
RECORDINGS = (
    argument("recordings", nargs="+", type=Path, metavar="FILE", help="CARMEN log, ROS 1 or ROS 2 bag"),
    argument("--mappers", default=",".join(MAPPERS), help="comma-separated list (default: %(default)s)"),
    FIGURES_JSON,
    argument("--plot", type=Path, metavar="FILE", help="draw the figures, as .svg or .png"),
)


def _rtt_arguments() -> tuple[Argument, ...]:
    from rce.bench.routes import DEFAULT_ROUTES, ROUTES  # slow

    routes, usual = ", ".join(ROUTES), ",".join(DEFAULT_ROUTES)
    return (
        argument("--routes", default=usual, help=f"comma-separated list of {routes} (default: {usual})"),
        argument("--features", default="", help="for route c2c2: two special features, each of one machine only"),
        argument("--sizes", type=int, default=25, help="how many, from 10 B to 10 MB (default: %(default)s)"),
        argument("--samples", type=int, default=20, help="of each size (default: %(default)s)"),
        argument("--quick", action="store_true", help=f"{QUICK_SIZES} sizes, {QUICK_SAMPLES} samples of each"),
        SAMPLES_JSON,
        argument("--plot", type=Path, metavar="FILE", help="draw the round trips, as .svg or .png"),
    )


def _network_arguments() -> tuple[Argument, ...]:
    from rce.bench.network.line import PROFILES
    from rce.bench.network.robot import MODES

    profiles, modes = ",".join(PROFILES), ",".join(MODES)
    return (
        argument("--profiles", default=profiles, help="comma-separated list (default: %(default)s)"),
        argument("--modes", default=modes, help="comma-separated list (default: %(default)s)"),
        argument("--seconds", type=float, default=30.0, help="of each run (default: %(default)s)"),
        SAMPLES_JSON,
    )


GROUP = Group("bench", "Measure a platform.")

COMMANDS = (
    Command(
        "bench rtt",
        "Measure round trips of messages of all sizes, beside those between two nodes.",
        Lazy(MODULE, "measure_round_trips"),
        _rtt_arguments,
        ("bench rtt --quick",),
        platform=RUNNING_OR_OWN,
        section=Section.LOCAL,
    ),
    Command(
        "bench overtake",
        "Measure velocity commands of a robot that sends 10 MB images at the same time.",
        Lazy(MODULE, "measure_overtake"),
        (
            argument("--samples", type=int, default=300, help="(default: %(default)s)"),
            argument(
                "--foxglove",
                type=float,
                default=0.0,
                metavar="SECONDS",
                help="measure a client of Foxglove instead: 1 MB at 100 Hz, and beside it a small topic at 10 Hz",
            ),
            SAMPLES_JSON,
        ),
        platform=RUNNING_OR_OWN,
        section=Section.LOCAL,
    ),
    Command(
        "bench viewers",
        "Measure a control loop beside many viewers of one camera, and how often its images are encoded.",
        Lazy(MODULE, "measure_viewers"),
        (
            argument("--viewers", type=int, default=50, help="(default: %(default)s)"),
            argument("--rates", default="0", help="images a second, in turn; 0: all (default: %(default)s)"),
            argument("--format", default="jpeg", help="format of the images (default: %(default)s)"),
            argument("--codec", default="", help="codec in place of a format"),
            argument("--samples", type=int, default=1000, help="of each phase (default: %(default)s)"),
            FIGURES_JSON,
        ),
        platform=RUNNING_OR_OWN,
        section=Section.LOCAL,
    ),
    Command(
        "bench delivery",
        "Measure the bytes of messages to a robot by the options of its interface.",
        Lazy(MODULE, "measure_delivery"),
        (
            argument("recording", type=Path, metavar="DIR", help="with NAME.color.jpg or .png and NAME.depth.png"),
            argument("--messages", type=int, default=60, help="of each kind (default: %(default)s)"),
            FIGURES_JSON,
        ),
        platform=RUNNING_OR_OWN,
        section=Section.LOCAL,
    ),
    Command(
        "bench bag",
        "Measure the rate and memory of a recording, and the intervals at which one is played in the cloud.",
        Lazy(MODULE, "measure_bags"),
        (
            argument("--rate", type=float, default=200, metavar="MB/S", help="recorded (default: %(default)s)"),
            argument("--seconds", type=float, default=60, help="of both (default: %(default)s)"),
            argument("--directory", type=Path, help="where to record (default: that of temporary files)"),
            SAMPLES_JSON,
        ),
        platform=RUNNING_OR_OWN,
        section=Section.LOCAL,
    ),
    Command(
        "bench start",
        "Measure starts of environments and services, prepared and not, beside a bare container.",
        Lazy(MODULE, "measure_start"),
        (
            argument("--engines", default="process,docker", help="comma-separated list (default: %(default)s)"),
            argument("--samples", type=int, default=10, help="of each (default: %(default)s)"),
            argument(
                "--image",
                default=f"rce/mapping:{__version__}",
                help="image of the bare container (default: %(default)s)",
            ),
            SAMPLES_JSON,
        ),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench control",
        "Measure logins and commands by one robot and by many at once.",
        Lazy(SCALE, "measure_control"),
        (
            argument("--robots", default="1,20", help="how many at once, a list (default: %(default)s)"),
            argument("--count", type=int, default=50, help="interfaces of a robot (default: %(default)s)"),
            ENGINE,
            SAMPLES_JSON,
        ),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench traffic",
        "Measure thousands of robots that send each other messages, and a node that floods a robot.",
        Lazy(SCALE, "measure_traffic"),
        (
            argument("--robots", default="1000", help="how many, a list (default: %(default)s)"),
            argument("--processes", default="1", help="of the Robot endpoint, a list (default: %(default)s)"),
            argument("--rate", type=float, default=10.0, help="messages of a robot in a second (default: %(default)s)"),
            argument("--size", type=int, default=1000, help="bytes of a message (default: %(default)s)"),
            argument("--flood", type=int, default=100, help="bytes of a message of the flood (default: %(default)s)"),
            argument("--seconds", type=float, default=10.0, help="of each measurement (default: %(default)s)"),
            SAMPLES_JSON,
        ),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench fleet",
        "Measure a Master with thousands of machines and robots, of which only the control connections are real.",
        Lazy(SCALE, "measure_fleet"),
        (
            argument("--machines", type=int, default=1000, help="(default: %(default)s)"),
            argument("--robots", type=int, default=10_000, help="each with an environment (default: %(default)s)"),
            argument("--json", action="store_true", help="print every figure as JSON instead of a table"),
        ),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench chaos",
        "Let processes of a platform fail at random, and check what it has acknowledged.",
        Lazy(SCALE, "measure_chaos"),
        (
            argument("--minutes", type=float, default=10, help="maximum duration (default: %(default)s)"),
            argument("--events", type=int, default=1000, help="maximum number of faults (default: %(default)s)"),
            argument("--seed", type=int, help="of an earlier run, to repeat it (default: a random one)"),
            argument("--dir", type=Path, help="empty directory for history and log (default: a temporary one)"),
            FIGURES_JSON,
        ),
        ("bench chaos --minutes 5", "bench chaos --seed 7 --events 60"),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench standby",
        "Let the leader of two Masters fail at random, and check what was acknowledged. Needs root and PostgreSQL.",
        Lazy(SCALE, "measure_standby"),
        (
            argument("--minutes", type=float, default=90, help="maximum duration (default: %(default)s)"),
            argument("--events", type=int, default=200, help="maximum number of faults (default: %(default)s)"),
            argument("--seed", type=int, help="of an earlier run, to repeat it (default: a random one)"),
            argument("--dir", type=Path, help="empty directory for history and log (default: a temporary one)"),
            FIGURES_JSON,
        ),
        ("bench standby --events 20", "bench standby --seed 7 --events 60"),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench map-service",
        "Measure the map service with a large recording and another user's job at the same time.",
        Lazy(MAPS, "measure_map_service"),
        (
            argument("--size", type=int, default=4000, help="of the recording, MB (default: %(default)s)"),
            argument(
                "--dir",
                type=Path,
                default=Path(tempfile.gettempdir()),
                help="directory on the disk to use (default: %(default)s)",
            ),
            ENGINE,
            FIGURES_JSON,
        ),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench dashboard",
        "Measure dashboard and lists of a Master with many robots and environments.",
        Lazy(SCALE, "measure_dashboard"),
        (
            argument("--robots", type=int, default=200, help="with an environment each (default: %(default)s)"),
            argument("--interfaces", type=int, default=5, help="of each robot and environment (default: %(default)s)"),
            argument("--seconds", type=float, default=20, help="to measure CPU shares for (default: %(default)s)"),
            argument("--samples", type=int, default=5, help="of page loads and lists (default: %(default)s)"),
            SAMPLES_JSON,
        ),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench map",
        "Measure time, memory and map quality of each mapper, with and without the map service.",
        Lazy(MAPS, "measure_maps"),
        (
            *RECORDINGS,
            argument("--odometry", default="", help="comma-separated list of recorded, noisy, worse, none"),
            argument("--no-service", action="store_true", help="the mappers alone, without a platform"),
            argument(
                "--workers",
                default="",
                metavar="N,...",
                help="map the recordings together, as `rce map --parallel`, with each of these numbers of workers",
            ),
            argument("--cut", type=int, default=1, help="with --workers: recordings that overlap, made of each FILE"),
            argument("--out", type=Path, metavar="DIR", help="for the maps"),
            ENGINE,
        ),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench plan",
        "Measure time and length of paths on maps of 2,000 x 2,000 cells and of a building.",
        Lazy(MAPS, "measure_planners"),
        (
            argument("maps", nargs="*", type=Path, metavar="MAP.yaml", help="further maps"),
            argument("--samples", type=int, default=5, help="of each (default: %(default)s)"),
            FIGURES_JSON,
        ),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench localise",
        "Measure whether and how exactly a robot is found in the map of the first half of a recording.",
        Lazy(MAPS, "measure_localisation"),
        (
            argument("recording", type=Path, metavar="FILE", help="CARMEN log, ROS 1 or ROS 2 bag"),
            argument("--parts", type=int, default=10, help="starts in its second half (default: %(default)s)"),
            argument("--scans", type=int, default=150, help="of each part (default: %(default)s)"),
            FIGURES_JSON,
        ),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench knowledge",
        "Measure searches of the knowledge repository with many entries.",
        Lazy(MODULE, "measure_knowledge"),
        (
            argument("--entries", type=int, default=10_000, help="(default: %(default)s)"),
            argument("--samples", type=int, default=50, help="of each search (default: %(default)s)"),
            FIGURES_JSON,
        ),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench video",
        "Measure size, time and delay of the video formats on recorded images with depth.",
        Lazy(MODULE, "measure_video"),
        (
            argument("recording", type=Path, metavar="DIR", help="with NAME.color.jpg or .png and NAME.depth.png"),
            argument("--images", type=int, default=90, help="at most so many pairs (default: %(default)s)"),
            FIGURES_JSON,
        ),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench endless",
        "Measure memory and time per scan while a recording is replayed forward and back again and again.",
        Lazy(MAPS, "measure_endless"),
        (
            *RECORDINGS,
            argument("--scans", type=int, default=36_000, help="(default: %(default)s, an hour at 10 Hz)"),
        ),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench network",
        "Measure a robot behind bad networks, beside plain JSON without priorities; needs root.",
        Lazy(SCALE, "measure_network"),
        _network_arguments,
        ("bench network --profiles lte --seconds 30",),
        platform=None,
        section=Section.LOCAL,
    ),
    Command(
        "bench soak",
        "Let robots come and go for a long time, and tell whether any process grows.",
        Lazy(SCALE, "measure_soak"),
        (
            argument("--minutes", type=float, default=120, help="(default: %(default)s)"),
            argument("--rate", type=float, default=20, help="robots that come, a minute (default: %(default)s)"),
            ENGINE,
            SAMPLES_JSON,
        ),
        platform=None,
        section=Section.LOCAL,
    ),
)
