"""Payload of a data message: JSON and the blobs to which it refers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias
from uuid import uuid4

import msgspec

from converters.scalars import FieldError

Buffer: TypeAlias = bytes | bytearray | memoryview


class Wire(msgspec.Struct, frozen=True):
    """Payload of a data message.

    Attributes:
        is_blob: The whole message is one blob (an image).
        raw: JSON value of `msg`, or of `msg*` (a blob id) if `is_blob`.
        blobs: Blobs by id.
    """

    is_blob: bool
    raw: Buffer | msgspec.Raw
    blobs: Mapping[str, Buffer]


class Incoming:
    """Blobs of a received message, with a record of those that fields have used."""

    def __init__(self, blobs: Mapping[str, Buffer]) -> None:
        self._blobs = blobs
        self._used: set[str] = set()

    def get(self, blob_id: str) -> Buffer:
        """Return a blob and mark it as used; raises FieldError if it is missing."""
        if blob_id not in self._blobs:
            raise FieldError(f"the message has no blob {blob_id[:40]!r}")
        self._used.add(blob_id)
        return self._blobs[blob_id]

    def check_all_used(self) -> None:
        """Raise FieldError for unused blobs: under the key of a field that accepts none they would be lost silently."""
        if len(self._used) < len(self._blobs):
            raise FieldError(
                f"{len(self._blobs) - len(self._used)} blob(s) belong to no field that accepts blobs: "
                "only byte arrays and sensor_msgs/Image do"
            )


class Outgoing(dict[str, Buffer]):
    """Blobs of a message to send, by id."""

    def add(self, blob: Buffer) -> str:
        """Add a blob and return its new id."""
        blob_id = uuid4().hex
        self[blob_id] = blob
        return blob_id
