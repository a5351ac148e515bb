"""What a data message carries: JSON and the blobs that it refers to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, TypeAlias
from uuid import uuid4

import msgspec

from converters.fitting import Misfit

Buffer: TypeAlias = bytes | bytearray | memoryview


class Wire(NamedTuple):
    """The payload of a data message: `raw` is the JSON value of `msg`, or of `msg*` (a blob id) if `whole`."""

    whole: bool
    raw: Buffer | msgspec.Raw
    blobs: Mapping[str, Buffer]


class Incoming:
    """The blobs of one message on their way in; each is for one field."""

    def __init__(self, blobs: Mapping[str, Buffer]) -> None:
        self._blobs = blobs
        self._taken: set[str] = set()

    def take(self, blob_id: str) -> Buffer:
        if blob_id not in self._blobs:
            raise Misfit(f"there is no blob {blob_id[:40]!r} with this message")
        self._taken.add(blob_id)
        return self._blobs[blob_id]

    def check_all_taken(self) -> None:
        """A blob under a key that takes none would be lost silently."""
        if len(self._taken) < len(self._blobs):
            raise Misfit(
                f"{len(self._blobs) - len(self._taken)} blob(s) belong to no field that takes one: "
                "those are byte arrays and sensor_msgs/Image"
            )


class Outgoing(dict[str, Buffer]):
    """The blobs of one message on their way out."""

    def add(self, blob: Buffer) -> str:
        blob_id = uuid4().hex
        self[blob_id] = blob
        return blob_id
