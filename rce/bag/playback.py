"""Topics by which a playback of a recording tells its state and is controlled, and their messages.

Both have the type `std_msgs/String`, with JSON in it, because that type is installed everywhere. Their names are
hidden ones in ROS.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

STATE, CONTROL = "/_rce/playback/state", "/_rce/playback/control"
TYPE = "std_msgs/msg/String"
STATE_PERIOD = 0.1  # seconds between two states while nothing else changes

Time = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Speed = Annotated[float, Meta(gt=0, le=1e6)]
Status = Literal["playing", "paused", "buffering", "ended"]


class PlaybackState(Struct, frozen=True, omit_defaults=True):
    """State of a playback.

    Attributes:
        status: What it does.
        time: Time of the recording that it has reached, in ns since 1970.
        speed: Speed; 1 is that of the recording.
        start: Time of the first message.
        end: Time of the last one.
        request: Id of the request that this answers; empty for none.
        seeked: It jumped to `time`.
    """

    status: Status
    time: Time
    speed: Speed
    start: Time
    end: Time
    request: str = ""
    seeked: bool = False


class PlaybackRequest(Struct, frozen=True, omit_defaults=True):
    """Request to play or pause, at a speed, and from a time (ns since 1970) on if it is given."""

    play: bool
    speed: float = 1.0
    seek: int | None = None
    id: str = ""


def encode(value: PlaybackState | PlaybackRequest) -> str:
    """Return a message as text."""
    return msgspec.json.encode(value).decode()
