"""Data messages of robots: the frame DM."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import UNSET, Meta, Raw, Struct, UnsetType

from rce.protocol.messages.frames import FrameId

MAX_MSG_ID = 255
MAX_STREAM = 64  # characters

Phase = Literal["", "goal", "accepted", "rejected", "feedback", "cancel", "result"]
GoalStatus = Literal["", "succeeded", "canceled", "aborted"]


class DataMessage(Struct, frozen=True, omit_defaults=True):
    """DM: one message of the robot's interface `iTag`, with the value under `msg`, or the id of its blob under `msg*`.

    A robot that provides a service sends `error` in place of both to report a failure.

    A message of an action has a `phase`, and the goal's UUID in 32 hex digits as its `msgID`. A result that a robot
    sends or gets has a `status`; without a value, the phases `goal` and `result` have the default values of all fields.
    A goal with `ifLost: cancel` is canceled when the session of the robot that has sent it ends.

    A message with a `stream`, which the robot chooses, and a `number`, which rises within the stream, is taken once:
    the Robot endpoint acknowledges it again if it comes again, and does not deliver it.
    """

    iTag: str
    type: str
    msgID: str
    msg: Raw | UnsetType = UNSET
    blob: Raw | UnsetType = msgspec.field(default=UNSET, name="msg*")
    error: str = ""
    phase: Phase = ""
    status: GoalStatus = ""
    ifLost: Literal["leave", "cancel"] = "leave"
    stream: Annotated[str, Meta(max_length=MAX_STREAM)] = ""
    number: Annotated[int, Meta(ge=0)] = 0


class DataFrame(Struct, frozen=True):
    """Text frame with a data message."""

    type: Literal["DM"]
    data: DataMessage
    id: FrameId | UnsetType = UNSET


_data_frame = msgspec.json.Decoder(DataFrame)


def decode_data_frame(payload: bytes) -> DataFrame | None:
    """Decode a text frame with a data message at once, which takes less time than its envelope and its data.

    Returns:
        None for all other frames, and for malformed ones: `decode_frame` and `decode_as` report what is wrong.
    """
    try:
        return _data_frame.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
