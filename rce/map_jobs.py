"""What the map service and its clients say to each other: uploads, options, jobs, and problems.

The OpenAPI document is made from these types. Times are seconds since 1970, sizes bytes, lengths metres.
"""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from msgspec import Meta, Struct

from rce.errors import ErrorInfo

PREFIX = "/map-service"
MOST_FILES = 64  # of one recording

Mapper = Literal["graph", "particle"]
State = Literal["queued", "running", "cancelling", "done", "failed", "cancelled"]
Topic = Annotated[str, Meta(max_length=255, pattern=r"^(/[A-Za-z0-9_/]*)?$")]
Name = Annotated[str, Meta(max_length=64, pattern="^[0-9a-f]+$")]
MAPPERS: tuple[Mapper, ...] = get_args(Mapper)
OVER: frozenset[State] = frozenset({"done", "failed", "cancelled"})


class MapOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """How a map is made."""

    mapper: Annotated[Mapper, Meta(description="the algorithm")] = "graph"
    resolution: Annotated[float, Meta(ge=0.01, le=0.5, description="metres a cell")] = 0.05
    max_range: Annotated[float, Meta(ge=1.0, le=200.0, description="longer beams are not used, metres")] = 30.0
    scan_topic: Annotated[Topic, Meta(description="of a bag with several topics of laser scans")] = ""
    odometry_topic: Annotated[Topic, Meta(description="of a bag with several topics of odometry")] = ""


class JobRequest(Struct, frozen=True, forbid_unknown_fields=True):
    """A map that is to be made. Several uploads are the files of one ROS 2 bag, its metadata.yaml among them."""

    uploads: Annotated[list[Name], Meta(min_length=1, max_length=MOST_FILES, description="ids of finished uploads")]
    options: MapOptions = MapOptions()
    name: Annotated[str, Meta(max_length=200, description="of the recording; else that of its file")] = ""


class Upload(Struct, frozen=True):
    """A file of a recording, `offset` bytes of which are there."""

    id: str
    name: str
    length: int
    offset: int
    expires: float
    fingerprint: str = ""  # the client's own mark, by which it finds a file again


class File(Struct, frozen=True):
    """A result of a job."""

    name: str
    size: int


class Job(Struct, frozen=True):
    """A map in the making, or made."""

    id: str
    state: State
    recording: str
    options: MapOptions
    uploads: list[str]
    created: float
    started: float | None = None
    ended: float | None = None
    expires: float | None = None  # when the job and its files are removed
    ahead: int = 0  # jobs of the same user that come first
    stage: str = ""  # what it does, or why it waits
    scans: int = 0  # mapped so far
    total: int | None = None  # where that is known
    times: dict[str, float] = {}  # seconds of each stage
    files: list[File] = []
    error: ErrorInfo | None = None


class Problem(Struct, frozen=True, omit_defaults=True):
    """What went wrong (RFC 9457). `code` is for programs, `field` the path of the field at fault."""

    title: str
    status: int
    detail: str
    code: str
    field: str = ""
    fields: dict[str, str | int | float | bool | list[str]] = {}
