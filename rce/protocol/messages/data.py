"""Data messages of robots: the frame DM."""

from __future__ import annotations

import msgspec
from msgspec import UNSET, Raw, Struct, UnsetType

MAX_MSG_ID = 255


class DataMessage(Struct, frozen=True, omit_defaults=True):
    """DM: one message of the robot's interface `iTag`, with the value under `msg`, or the id of its blob under `msg*`.

    A robot that provides a service sends `error` in place of both to report a failure.
    """

    iTag: str
    type: str
    msgID: str
    msg: Raw | UnsetType = UNSET
    blob: Raw | UnsetType = msgspec.field(default=UNSET, name="msg*")
    error: str = ""
