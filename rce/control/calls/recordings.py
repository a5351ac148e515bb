"""Calls about recordings, which task sets keep on their machines."""

from __future__ import annotations

from typing import Literal

from msgspec import Struct

from rce.control.calls.call import Call, Nothing

PIECE = 256 * 1024  # bytes of a recording in one call

RecordingState = Literal["recording", "uploading", "complete", "cut off"]
"""Being recorded or uploaded, complete, or without an end because its environment or machine ended before."""


class RecordingQuota(Struct, frozen=True):
    """Bytes that all recordings of a user may have on one machine; None is no limit."""

    bytes: int | None = None


class BeginRecording(Call[RecordingQuota], frozen=True):
    """Ask the Master whether a recorder of an environment of this task set may record. Raises NotFound."""

    environment: str  # userID/containerTag
    recorder: str


class RecordingInfo(Struct, frozen=True):
    """A recording; `environment` and `recorder` are tags, empty for one that was uploaded.

    `size` is in bytes, `created` in seconds since 1970. Of an upload, `length` is the announced size, and `fingerprint`
    a text by which its client finds it again.
    """

    id: str
    name: str
    state: RecordingState
    size: int
    created: float
    environment: str = ""
    recorder: str = ""
    length: int = 0
    fingerprint: str = ""


class Recordings(Struct, frozen=True):
    """Recordings of one user on one machine, the newest first."""

    recordings: list[RecordingInfo]


class ListRecordings(Call[Recordings], frozen=True):
    """List the recordings of a user on this machine."""

    user: str


class Piece(Struct, frozen=True):
    """Piece of a recording."""

    data: bytes


class ReadRecording(Call[Piece], frozen=True):
    """Read at most `length` bytes of a recording, and at most PIECE. Raises NotFound."""

    user: str
    recording: str
    offset: int
    length: int


class RemoveRecording(Call[Nothing], frozen=True):
    """Remove a recording; one that is being recorded ends. Raises NotFound."""

    user: str
    recording: str


class AnnounceRecording(Call[RecordingInfo], frozen=True):
    """Make room for a recording that a user uploads. Raises InvalidRequest, LimitExceeded, DiskFull."""

    user: str
    name: str
    length: int
    fingerprint: str
    quota: RecordingQuota


class AppendRecording(Call[RecordingInfo], frozen=True):
    """Append bytes to an upload. Raises NotFound, and OffsetMismatch if `offset` is not its size."""

    user: str
    recording: str
    offset: int
    data: bytes
