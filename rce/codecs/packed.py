"""Messages in which packets travel, in place of those of their type."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

Unsigned = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Text = Annotated[str, Meta(max_length=255)]


class Stamp(Struct, frozen=True):
    """A time."""

    sec: int = 0
    nanosec: int = 0


class Header(Struct, frozen=True):
    """Header of the message."""

    stamp: Stamp = Stamp()
    frame_id: str = ""


class PackedImage(Struct, frozen=True, kw_only=True):
    """A packed `sensor_msgs/Image`.

    Attributes:
        header: Header of the image.
        codec: Codec.
        encoding: Encoding of the pixels: `rgb8` of video, that of the image for depth.
        height: Rows.
        width: Columns.
        number: Place in the sequence of its encoder; a gap means that a packet was dropped.
        key: Whether it can be decoded without those before it.
    """

    header: Header = Header()
    codec: Text
    encoding: Text = "rgb8"
    height: Unsigned = 0
    width: Unsigned = 0
    number: Unsigned = 0
    key: bool = True


class CloudField(Struct, frozen=True):
    """A `sensor_msgs/PointField`."""

    name: Text
    offset: Unsigned = 0
    datatype: Annotated[int, Meta(ge=1, le=8)] = 7
    count: Annotated[int, Meta(ge=1, le=1000)] = 1


class PackedCloud(Struct, frozen=True, kw_only=True):
    """A packed `sensor_msgs/PointCloud2`, with the layout of its points."""

    header: Header = Header()
    codec: Text
    height: Unsigned = 1
    width: Unsigned = 0
    fields: Annotated[list[CloudField], Meta(max_length=100)] = []
    point_step: Annotated[int, Meta(ge=1, le=65_535)] = 1
    is_dense: bool = False
