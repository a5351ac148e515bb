"""`map3d`: maps of recorded cameras with depth, and of recorded lidars."""

from __future__ import annotations

from pathlib import Path

from rce.cli.arguments import RUNNING_OR_OWN, argument
from rce.cli.command import Command, Lazy, Section

CAMERA = argument("--camera", metavar="FX,FY,CX,CY", help="intrinsics in pixels (default: those of the recording)")
DEPTH_SCALE = argument(
    "--depth-scale",
    type=float,
    metavar="N",
    help="units of depth images in a metre (default: 5000 for TUM, else 1000)",
)
TOPIC = argument("--topic", default="", help="of the clouds, in a bag with several lidars or with a camera too")

COMMANDS = (
    Command(
        "map3d",
        "Make a three-dimensional map of recordings of cameras with depth or of lidars.",
        Lazy("rce.cli.lazy.map3d", "run"),
        (
            argument(
                "recordings",
                nargs="+",
                type=Path,
                metavar="RECORDING",
                help="directory in the format of TUM or 7-Scenes, ROS 1 or ROS 2 bag; several are robots that map "
                "together",
            ),
            argument(
                "--out",
                type=Path,
                default=Path("map3d"),
                metavar="DIR",
                help="for the map's files (default: %(default)s)",
            ),
            CAMERA,
            DEPTH_SCALE,
            TOPIC,
        ),
        (
            "map3d rgbd_dataset_freiburg1_desk --out desk",
            "map3d first.bag second.bag third.bag --out building",
            "map3d lidar.mcap --topic /points",
        ),
        platform=RUNNING_OR_OWN,
        section=Section.LOCAL,
        description="Tracks the camera or the lidar here, sends key frames through a platform to its mapping node, and "
        "writes what comes back: trajectory.txt (one for each robot: trajectory-1.txt and so on), cloud.ply, mesh.ply, "
        "map.bt, map.pgm, map.yaml and view.png.",
    ),
    Command(
        "bench map3d",
        "Measure errors and cost of three-dimensional maps of recordings with ground truth.",
        Lazy("rce.cli.lazy.bench_map3d", "measure"),
        (
            argument(
                "recordings",
                nargs="+",
                type=Path,
                metavar="RECORDING",
                help="as for `rce map3d`; ground truth is groundtruth.txt or frame-NNNNNN.pose.txt",
            ),
            CAMERA,
            DEPTH_SCALE,
            TOPIC,
            argument("--offloading", action="store_true", help="compare the ways to divide the work with the cloud"),
            argument("--json", action="store_true", help="print the figures as JSON"),
        ),
        ("bench map3d rgbd_dataset_freiburg1_desk",),
        platform=None,
        section=Section.LOCAL,
    ),
)
