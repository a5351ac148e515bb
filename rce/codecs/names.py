"""The codecs of each message type."""

from __future__ import annotations

from importlib.util import find_spec

from rce.errors import InvalidRequest
from rce.protocol.names import parse_type

COLOR = ("h264", "av1", "vp9")
DEPTH = ("palette", "ffv1", "png")
QUANTISED, DRACO = "quantised", "draco"
IMAGE, CLOUD = "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2"
CODECS: dict[str, tuple[str, ...]] = {IMAGE: (*COLOR, *DEPTH), CLOUD: (QUANTISED, DRACO)}
NEEDS = {**dict.fromkeys((*COLOR, *DEPTH), ("av", "video")), DRACO: ("DracoPy", "draco")}
"""Module that a codec needs, and the extra that brings it."""


def is_series(codec: str) -> bool:
    """Return True if a packet needs those before it: the codec has state."""
    return codec in COLOR


def check(codec: str, type_name: str) -> None:
    """Check that messages of a type can be packed by a codec here.

    Raises:
        InvalidRequest: The type does not have this codec, or what it needs is not installed.
    """
    known = CODECS.get(parse_type(type_name).msg, ())
    if codec not in known:
        has = f"it has {', '.join(known)}" if known else f"{' and '.join(CODECS)} have some"
        raise InvalidRequest(f"there is no codec {codec[:40]!r} for {type_name[:80]}: {has}", field="codec")
    module, extra = NEEDS.get(codec, ("", ""))
    if module and find_spec(module) is None:
        raise InvalidRequest(
            f"the codec {codec} needs the extra `{extra}`, which is not installed: run pip install -e '.[{extra}]'",
            field="codec",
        )
