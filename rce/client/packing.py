"""Images and clouds of interfaces with a codec: NumPy arrays here, packets on the line.

Without the extra of a codec a subscriber gets the packets, and a publisher sends those that the program makes.
"""

from __future__ import annotations

import time
from importlib.util import find_spec
from typing import Any

import msgspec

from rce.codecs.names import CLOUD, NEEDS
from rce.codecs.packed import Header, PackedCloud, PackedImage
from rce.errors import InvalidRequest
from rce.protocol.names import parse_type

Value = dict[str, Any]


def can_unpack(codec: str) -> bool:
    """Return whether what a codec needs is installed."""
    return find_spec("numpy") is not None and find_spec(NEEDS.get(codec, ("numpy", ""))[0]) is not None


class Unpacker:
    """Unpacks the messages of a subscriber."""

    def __init__(self, codec: str, type_name: str) -> None:
        """Make an unpacker of messages of a type."""
        self._is_cloud = parse_type(type_name).msg == CLOUD
        self._images: Any = None
        if not self._is_cloud and can_unpack(codec):
            from rce.codecs.images import ImageDecoder

            self._images = ImageDecoder(codec)
        self._raw = not can_unpack(codec)

    def unpack(self, value: Value) -> Value | None:
        """Return a message with an array, or None while video waits for a key frame.

        Images have `header`, `encoding` and `image` (height, width, 3) or (height, width); clouds have `header`,
        `height`, `width` and `points`, a structured array.

        Raises:
            ConversionError: The packet is damaged.
        """
        if self._raw:
            return value
        data = value.pop("data")
        if self._is_cloud:
            from rce.codecs.clouds import unpack

            cloud = msgspec.convert(value, PackedCloud)
            return {**value, "points": unpack(cloud, data)}
        image = self._images.decode(msgspec.convert(value, PackedImage), data)
        return None if image is None else {"header": value["header"], "encoding": value["encoding"], "image": image}


class Packer:
    """Packs the messages of a publisher; video adapts its rate of bytes to what the line carries."""

    def __init__(self, codec: str, type_name: str) -> None:
        """Make a packer of messages of a type."""
        self._codec = codec
        self._is_cloud = parse_type(type_name).msg == CLOUD
        self._images: Any = None
        self._rate: Any = None
        self._dropped = 0

    def request_key(self) -> None:
        """Make the next packet of video a key frame: somebody has joined, or misses one."""
        if self._images is not None:
            self._images.request_key()

    def pack(self, value: Any, dropped: int = 0) -> Any:
        """Return a message as a packet; a packet stays as it is.

        Args:
            value: The message: an array, or a dict with `image` and `encoding` or with `points`, and with a `header`.
            dropped: Number of packets that were dropped so far.

        Raises:
            InvalidRequest: It has no array, or the extra of the codec is not installed.
            ConversionError: The codec is not for such images or clouds.
        """
        if isinstance(value, dict) and "data" in value:
            return value
        if not can_unpack(self._codec):
            module, extra = NEEDS.get(self._codec, ("numpy", "images"))
            raise InvalidRequest(f"the codec {self._codec} needs {module}: run pip install -e '.[{extra}]'")
        parts = value if isinstance(value, dict) else {"points" if self._is_cloud else "image": value}
        header = msgspec.convert(parts.get("header", {}), Header)
        head, data = (self._pack_cloud if self._is_cloud else self._pack_image)(parts, header, dropped)
        return {**msgspec.to_builtins(head), "data": data}

    def _pack_image(self, parts: Value, header: Header, dropped: int) -> tuple[PackedImage, bytes]:
        from rce.codecs.images import ImageEncoder
        from rce.video.rate import RateControl

        if "image" not in parts:
            raise InvalidRequest("an interface with a codec for images sends {'image': array, 'encoding': 'rgb8'}")
        if self._images is None:
            self._images, self._rate = ImageEncoder(self._codec), RateControl()
        missed, self._dropped = dropped > self._dropped, dropped
        if missed:
            self._images.request_key()
        if self._rate.report(time.monotonic(), missed):
            self._images.set_bitrate(self._rate.rate)
        image = parts["image"]
        encoding = parts.get("encoding") or ("16UC1" if image.dtype.itemsize == 2 else "rgb8")
        packed: tuple[PackedImage, bytes] = self._images.encode(image, encoding, header)
        return packed

    def _pack_cloud(self, parts: Value, header: Header, dropped: int) -> tuple[PackedCloud, bytes]:
        from rce.codecs.clouds import dtype_of, empty_head, pack

        if "points" not in parts or parts["points"].dtype.fields is None:
            raise InvalidRequest("an interface with a codec for clouds sends {'points': structured array}")
        points = parts["points"]
        head = empty_head(header, self._codec, points)
        if "height" in parts:
            head = msgspec.structs.replace(head, height=parts["height"], width=parts["width"])
        return pack(self._codec, head, points.view(dtype_of(head.fields, head.point_step)))
