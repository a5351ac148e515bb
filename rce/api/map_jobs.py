"""Types of the map service's HTTP API: uploads, options and jobs.

The OpenAPI document is generated from these types. Times are seconds since 1970, sizes bytes, lengths metres.
"""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from msgspec import Meta, Struct

from rce.errors import ErrorInfo

PREFIX = "/map-service"
MAX_FILES = 64  # of one recording

Kind = Literal["2d", "3d"]
Mapper = Literal["graph", "particle"]
State = Literal["queued", "running", "cancelling", "done", "failed", "cancelled"]
# In Python, `$` alone also matches before a newline at the end.
Topic = Annotated[str, Meta(max_length=255, pattern=r"^(/[A-Za-z0-9_/]*)?$(?!\n)")]
UploadId = Annotated[str, Meta(max_length=64, pattern=r"^[0-9a-f]+$(?!\n)")]
MAPPERS: tuple[Mapper, ...] = get_args(Mapper)
KINDS: tuple[Kind, ...] = get_args(Kind)
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


class JobRequest(Struct, frozen=True, forbid_unknown_fields=True):
    """Mapping job to start. Several uploads are the files of one ROS 2 bag, including its metadata.yaml."""

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
