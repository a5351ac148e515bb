"""The codecs of each message type."""

from __future__ import annotations

from importlib.util import find_spec

from rce.errors import InvalidRequest
from rce.protocol.names import parse_type

COLOR = ("h264", "av1", "vp9")
DEPTH = ("palette", "ffv1", "png")
QUANTISED, DRACO = "quantised", "draco"
IMAGE, CLOUD = "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2"
FOXGLOVE, FFMPEG = "foxglove_msgs/msg/CompressedVideo", "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
FOXGLOVE_CLOUD = "foxglove_msgs/msg/CompressedPointCloud"
VIDEO = (FOXGLOVE, FFMPEG)  # types whose messages are packets themselves
CODECS: dict[str, tuple[str, ...]] = {
    IMAGE: (*COLOR, *DEPTH),
    CLOUD: (QUANTISED, DRACO),
    **dict.fromkeys(VIDEO, COLOR),
}
NEEDS = {**dict.fromkeys((*COLOR, *DEPTH), ("av", "video")), DRACO: ("DracoPy", "draco")}
"""Module that a codec needs, and the extra that brings it."""


def is_series(codec: str, type_name: str = IMAGE) -> bool:
    """Return True if a packet needs those before it: the codec has state."""
    return codec in COLOR and parse_type(type_name).msg == IMAGE


def check(codec: str, type_name: str, *, receives: bool = True) -> None:
    """Check that messages of a type can be packed, and those that a robot sends unpacked, by a codec here.

    Args:
        codec: The codec.
        type_name: Type of the messages.
        receives: Whether the robot receives them.

    Raises:
        InvalidRequest: The type does not have this codec, or what it needs is not installed.
    """
    name = parse_type(type_name).msg
    known = CODECS.get(name, ())
    if codec not in known:
        has = f"it has {', '.join(known)}" if known else f"{', '.join(CODECS)} have some"
        raise InvalidRequest(f"there is no codec {codec[:40]!r} for {type_name[:80]}: {has}", field="codec")
    if name in VIDEO:
        if receives:
            raise InvalidRequest(f"{type_name} is video already: leave out the codec", field="codec")
        return  # it stays packed
    module, extra = NEEDS.get(codec, ("", ""))
    if module and find_spec(module) is None:
        raise InvalidRequest(
            f"the codec {codec} needs the extra `{extra}`, which is not installed: run pip install -e '.[{extra}]'",
            field="codec",
        )
