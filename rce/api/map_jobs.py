"""Types of the map service's HTTP API: uploads, options and jobs.

The OpenAPI document is generated from these types. Times are seconds since 1970, sizes bytes, lengths metres.
"""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from msgspec import Meta, Struct

from rce.errors import ErrorInfo

PREFIX = "/map-service"
MAX_FILES = 64  # of one job
MAX_PARALLEL = 16  # workers of one job

Kind = Literal["2d", "3d"]
Mapper = Literal["graph", "particle"]
State = Literal["queued", "running", "cancelling", "done", "failed", "cancelled"]
# In Python, `$` alone also matches before a newline at the end.
Topic = Annotated[str, Meta(max_length=255, pattern=r"^(/[A-Za-z0-9_/]*)?$(?!\n)")]
UploadId = Annotated[str, Meta(max_length=64, pattern=r"^[0-9a-f]+$(?!\n)")]
MAPPERS: tuple[Mapper, ...] = get_args(Mapper)
KINDS: tuple[Kind, ...] = get_args(Kind)
Planner = Literal["astar", "hybrid", "voronoi"]
MotionModel = Literal["DUBIN", "REEDS_SHEPP"]
PLANNERS: tuple[Planner, ...] = get_args(Planner)
MOTION_MODELS: tuple[MotionModel, ...] = get_args(MotionModel)
FINAL_STATES: frozenset[State] = frozenset({"done", "failed", "cancelled"})


class MapOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """Mapper and its settings."""

    mapper: Annotated[Mapper, Meta(description="the mapping algorithm")] = "graph"
    resolution: Annotated[float, Meta(ge=0.01, le=0.5, description="metres per cell")] = 0.05
    max_range: Annotated[float, Meta(ge=1.0, le=200.0, description="metres; longer beams are ignored")] = 30.0
    scan_topic: Annotated[Topic, Meta(description="for a bag with several topics of laser scans")] = ""
    odometry_topic: Annotated[Topic, Meta(description="for a bag with several topics of odometry")] = ""
    kind: Annotated[
        Kind, Meta(description="2d: laser scans; 3d: a bag with colour, depth and camera_info, without other options")
    ] = "2d"
    parallel: Annotated[
        int, Meta(ge=1, le=MAX_PARALLEL, description="workers, each in an environment of its own; of kind 2d")
    ] = 1


class JobRequest(Struct, frozen=True, forbid_unknown_fields=True):
    """Mapping job to start.

    Several uploads are the files of one ROS 2 bag, if metadata.yaml is one of them; else each is a recording, and those
    that overlap become one map.
    """

    uploads: Annotated[list[UploadId], Meta(min_length=1, max_length=MAX_FILES, description="ids of finished uploads")]
    options: MapOptions = MapOptions()
    name: Annotated[str, Meta(max_length=200, description="name of the recording; by default that of its file")] = ""


class Upload(Struct, frozen=True):
    """File of a recording, of which `offset` bytes have been received."""

    id: str
    name: str
    length: int
    offset: int
    expires: float
    fingerprint: str = ""  # the client's own hash, by which it recognizes the file when it resumes


class File(Struct, frozen=True):
    """Result of a job."""

    name: str
    size: int


class Job(Struct, frozen=True):
    """Mapping job and its state."""

    id: str
    state: State
    recording: str
    options: MapOptions
    uploads: list[str]
    created: float
    started: float | None = None
    ended: float | None = None
    expires: float | None = None  # when the job and its files are removed
    ahead: int = 0  # jobs of the same user that run before it
    stage: str = ""  # current step, or the reason for waiting
    scans: int = 0  # mapped so far; of kind 3d: frames
    total: int | None = None  # scans or frames of the recording, if known
    times: dict[str, float] = {}  # seconds of each stage
    files: list[File] = []
    error: ErrorInfo | None = None


Coordinate = Annotated[float, Meta(ge=-1e6, le=1e6, description="metres, map frame")]
Angle = Annotated[float, Meta(ge=-1e3, le=1e3, description="radians")]


class PlanPose(Struct, frozen=True, forbid_unknown_fields=True):
    """Pose on a map."""

    x: Coordinate
    y: Coordinate
    theta: Angle = 0.0


class PlanRequest(Struct, frozen=True, forbid_unknown_fields=True):
    """Path to plan on the map of a job. Names and defaults are those of Nav2, except for `allow_unknown`."""

    start: PlanPose
    goal: PlanPose
    planner: Planner = "astar"
    footprint: Annotated[
        str, Meta(max_length=2000, description="radius in metres, or corners as [[0.3, 0.2], [0.3, -0.2], [-0.3, 0]]")
    ] = "0.2"
    allow_unknown: Annotated[bool, Meta(description="unknown space is free")] = False
    tolerance: Annotated[float, Meta(ge=0, le=100, description="metres to the goal; not of hybrid")] = 0.125
    cost_travel_multiplier: Annotated[float, Meta(ge=0, le=100, description="weight of costs beside the length")] = 2.0
    max_planning_time: Annotated[float, Meta(gt=0, le=30, description="seconds")] = 2.0
    minimum_turning_radius: Annotated[float, Meta(ge=0.05, le=100, description="metres; of hybrid")] = 0.4
    motion_model_for_search: Annotated[MotionModel, Meta(description="of hybrid: REEDS_SHEPP also reverses")] = "DUBIN"


class Waypoint(Struct, frozen=True, array_like=True):
    """Pose of a path: `[x, y, theta, direction]`; direction is 1, or -1 if the pose is reached in reverse."""

    x: float
    y: float
    theta: float
    direction: int


class Plan(Struct, frozen=True):
    """Path on the map of a job; metres, radians and seconds."""

    poses: list[Waypoint]
    length: float
    seconds: float
