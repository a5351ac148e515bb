"""Codec of interfaces with a `codec`: the blob of a message is a packet, and its JSON says how to unpack it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NoReturn

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from converters.codec import Codec, Recipe
from converters.images import ENCODINGS, Picture, pixels_of
from converters.model import Message
from converters.namespaces import Fields, Namespaces
from converters.scalars import FieldError, TimeValue
from converters.wire import Buffer, Outgoing, Wire
from rce.codecs import clouds
from rce.codecs.names import CLOUD, FFMPEG, FOXGLOVE, IMAGE, is_series
from rce.codecs.packed import CloudField, Header, PackedCloud, PackedImage, Stamp
from rce.errors import ConversionError

KEY_FIELD = "key"  # of the error that asks for a key frame


class PackedCodec:
    """Codec of packets.

    Attributes:
        recipe: What another process needs to make the same codec. One with a `stream` has state.
    """

    def __init__(self, codec: Codec, recipe: Recipe) -> None:
        """Make a codec for the type of another; its recipe names the codec, the stream and the rate."""
        self.recipe = recipe
        self._name = codec.message.name
        self._packing = _PACKINGS[codec.message.name](codec.message, recipe)
        self._namespaces = Namespaces(codec.message)

    def encodes_fast(self, wire: Wire) -> bool:
        """Return False: unpacking takes some milliseconds."""
        return False

    def decodes_fast(self, cdr: Buffer) -> bool:
        """Return False: packing takes some milliseconds."""
        return False

    def request_key(self) -> None:
        """Make the next packet a key frame."""
        self._packing.request_key()

    def encode(self, wire: Wire) -> bytes:
        """Convert a packet of the robot to CDR.

        Raises:
            ConversionError: It is damaged, or video waits for a key frame: then `field` is `key`.
        """
        try:
            value = msgspec.json.decode(wire.raw)
            data = wire.blobs[value.pop("data*")]
            head: Any = msgspec.convert(value, self._packing.head)
        except (msgspec.DecodeError, msgspec.ValidationError, AttributeError, KeyError, TypeError) as error:
            raise ConversionError(f"{self._name}: the packet has no head, or no blob as data*: {error}") from None
        if head.codec != self.recipe.codec:
            raise ConversionError(f"the packet is {head.codec}, the interface {self.recipe.codec}", field="codec")
        try:
            return self._namespaces.write(self._packing.unpack(head, bytes(data)))
        except FieldError as error:
            self._refuse(error)

    def decode(self, cdr: Buffer) -> Wire:
        """Convert CDR to a packet for the robot; raises ConversionError."""
        try:
            head, data = self._packing.pack(self._namespaces.read(cdr))
        except FieldError as error:
            self._refuse(error)
        blobs = Outgoing()
        value = msgspec.to_builtins(head) | {"data*": blobs.add(data)}
        return Wire(False, msgspec.json.encode(value), blobs)

    def _refuse(self, error: FieldError) -> NoReturn:
        raise ConversionError(f"{self._name} {error.path}: {error.reason}", field=error.path) from error


class _Packing:
    """Packing of a type whose first field is a header."""

    head: type[Struct]

    def __init__(self, message: Message, recipe: Recipe) -> None:
        first = message.members[0].message  # the header, or the stamp
        assert first is not None
        self._header = first.model
        self._codec = recipe.codec

    def request_key(self) -> None:
        """Make the next packet a key frame, if it depends on others."""

    def pack(self, fields: Fields) -> tuple[Struct, bytes]:
        """Return a message as a packet."""
        raise NotImplementedError

    def unpack(self, head: Any, data: bytes) -> Fields:
        """Return the fields of a message."""
        raise NotImplementedError

    def _to_model(self, header: Header) -> Struct:
        return self._header(TimeValue(header.stamp.sec, header.stamp.nanosec), header.frame_id)


def _header_of(fields: Fields) -> Header:
    stamp, frame_id = msgspec.structs.astuple(fields.header)
    return Header(Stamp(*msgspec.structs.astuple(stamp)), frame_id)


class _Images(_Packing):
    head = PackedImage

    def __init__(self, message: Message, recipe: Recipe) -> None:
        from rce.codecs.images import ImageDecoder, ImageEncoder  # the extra `video`

        super().__init__(message, recipe)
        self._encoder = ImageEncoder(recipe.codec, recipe.bitrate)
        self._decoder = ImageDecoder(recipe.codec)

    def request_key(self) -> None:
        self._encoder.request_key()

    def pack(self, fields: Fields) -> tuple[Struct, bytes]:
        if fields.encoding not in ENCODINGS:
            raise FieldError(f"images in {fields.encoding[:40]!r} have no codec: {', '.join(ENCODINGS)}", "encoding")
        big, step = fields.is_bigendian, fields.step
        picture = Picture(fields.height, fields.width, fields.encoding, big, step, fields.data)
        return self._encoder.encode(pixels_of(picture, ENCODINGS[fields.encoding]), fields.encoding, _header_of(fields))

    def unpack(self, head: PackedImage, data: bytes) -> Fields:
        image = self._decoder.decode(head, data)
        if image is None:
            raise ConversionError("video waits for a key frame: send one, as after each drop", field=KEY_FIELD)
        encoding = "rgb8" if is_series(self._codec) else head.encoding
        rows = np.ascontiguousarray(image, image.dtype.newbyteorder("<"))
        sizes = {"height": image.shape[0], "width": image.shape[1], "step": rows.nbytes // image.shape[0]}
        return SimpleNamespace(
            header=self._to_model(head.header), encoding=encoding, is_bigendian=0, data=rows.tobytes(), **sizes
        )


class _Clouds(_Packing):
    head = PackedCloud

    def __init__(self, message: Message, recipe: Recipe) -> None:
        super().__init__(message, recipe)
        field = message.members[3].message
        assert field is not None
        self._field = field.model

    def pack(self, fields: Fields) -> tuple[Struct, bytes]:
        if fields.is_bigendian:
            raise FieldError("big-endian points have no codec", "is_bigendian")
        layout = [CloudField(*msgspec.structs.astuple(each)) for each in fields.fields]
        head = PackedCloud(
            header=_header_of(fields), codec=self._codec, height=fields.height, width=fields.width, fields=layout,
            point_step=fields.point_step, is_dense=fields.is_dense,
        )  # fmt: skip
        return clouds.pack(self._codec, head, _points(fields, clouds.dtype_of(layout, fields.point_step)))

    def unpack(self, head: PackedCloud, data: bytes) -> Fields:
        points = clouds.unpack(head, data)
        layout = [self._field(each.name, each.offset, each.datatype, each.count) for each in head.fields]
        return SimpleNamespace(
            header=self._to_model(head.header), height=head.height, width=head.width, fields=layout, is_bigendian=False,
            point_step=head.point_step, row_step=head.width * head.point_step, data=points.tobytes(),
            is_dense=head.is_dense,
        )  # fmt: skip


def _points(fields: Fields, kind: np.dtype[Any]) -> NDArray[Any]:
    """Return the points of a cloud in one row, without the padding of its rows."""
    size = fields.width * fields.point_step
    if not fields.height * size:
        return np.zeros(0, kind)
    if fields.row_step < size or fields.row_step * fields.height > len(fields.data):
        raise FieldError(f"{len(fields.data)} bytes are not {fields.height} rows of {fields.row_step}", "data")
    rows = np.frombuffer(fields.data, np.uint8, fields.row_step * fields.height).reshape(fields.height, -1)
    return np.ascontiguousarray(rows[:, :size]).reshape(-1).view(kind)


class _CompressedVideo(_Packing):
    """Video stays packed."""

    head = PackedImage

    def pack(self, fields: Fields) -> tuple[Struct, bytes]:
        raise ConversionError("it is video already")

    def unpack(self, head: PackedImage, data: bytes) -> Fields:
        stamp = TimeValue(head.header.stamp.sec, head.header.stamp.nanosec)
        return SimpleNamespace(timestamp=stamp, frame_id=head.header.frame_id, data=data, format=head.codec)


class _FfmpegPacket(_CompressedVideo):
    def unpack(self, head: PackedImage, data: bytes) -> Fields:
        return SimpleNamespace(
            header=self._to_model(head.header), width=head.width, height=head.height, encoding=head.codec,
            pts=head.number, flags=int(head.key), is_bigendian=False, data=data,
        )  # fmt: skip


_PACKINGS: dict[str, type[_Packing]] = {
    IMAGE: _Images,
    CLOUD: _Clouds,
    FOXGLOVE: _CompressedVideo,
    FFMPEG: _FfmpegPacket,
}
