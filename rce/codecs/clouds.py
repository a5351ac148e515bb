"""Clouds of points in a small form.

`quantised`: the values of each field together, one field after the other, as zlib (RFC 1950). A float is a 16-bit
number of equal steps between the least and the greatest value of its field (32-bit for a float64); the last number is
NaN. Colours and integers stay as they are. In front of each field of floats are its least and greatest value as two
float64, little endian as all values. Points keep their order.

`draco`: Google's Draco, a kd-tree of the points. It drops points that are not finite and their order, so that the cloud
is dense and has one row.
"""

from __future__ import annotations

import zlib
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from rce.codecs.names import DRACO
from rce.codecs.packed import CloudField, Header, PackedCloud
from rce.errors import ConversionError

Points = NDArray[Any]  # (n,) of a structured type
TYPES = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}  # of sensor_msgs/PointField
COLORS = ("rgb", "rgba")  # bytes within a float
MAX_BYTES = 1 << 26
DRACO_BITS = 14  # of a coordinate


def dtype_of(fields: list[CloudField], point_step: int) -> np.dtype[Any]:
    """Return the type of one point; raises ConversionError for fields that do not fit into it."""
    try:
        return np.dtype(
            {
                "names": [each.name for each in fields],
                "formats": [(TYPES[each.datatype], (each.count,)) for each in fields],
                "offsets": [each.offset for each in fields],
                "itemsize": point_step,
            }
        )
    except (ValueError, TypeError) as error:
        raise ConversionError(f"the fields of the cloud are no layout: {error}", field="fields") from None


def pack(codec: str, head: PackedCloud, points: Points) -> tuple[PackedCloud, bytes]:
    """Return points as a packet, with its head.

    Args:
        codec: Codec.
        head: Head for all points, in rows; the codec may change it.
        points: The points.

    Raises:
        ConversionError: The codec is not for such points.
    """
    return _pack_draco(head, points) if codec == DRACO else (head, _quantise(head, points))


def unpack(head: PackedCloud, data: bytes) -> Points:
    """Return the points of a packet; raises ConversionError if it is damaged."""
    kind = dtype_of(head.fields, head.point_step)
    count = head.height * head.width
    if count * head.point_step > MAX_BYTES:
        raise ConversionError(f"a cloud of {count} points has more than {MAX_BYTES} bytes", field="width")
    points = np.zeros(count, kind)
    try:
        if head.codec == DRACO:
            _unpack_draco(head, data, points)
        else:
            _dequantise(head, data, points)
    except (ValueError, zlib.error, KeyError, IndexError) as error:
        raise ConversionError(f"a packet of {head.codec[:40]} is damaged: {error}", field="data") from None
    return points


def _quantise(head: PackedCloud, points: Points) -> bytes:
    parts: list[bytes] = []
    for field in head.fields:
        values = points[field.name]
        if field.datatype < 7 or field.name in COLORS:
            parts.append(np.ascontiguousarray(values).tobytes())
            continue
        finite = np.isfinite(values)
        low, high = (float(values[finite].min()), float(values[finite].max())) if finite.any() else (0.0, 0.0)
        steps = _steps(field)
        scaled = (values.astype(np.float64) - low) / ((high - low) or 1.0) * (steps.max - 1)
        whole = np.where(finite, np.nan_to_num(np.rint(scaled), posinf=0, neginf=0), steps.max).astype(steps.dtype)
        parts += [np.array([low, high], "<f8").tobytes(), whole.tobytes()]
    return zlib.compress(b"".join(parts), 1)


def _dequantise(head: PackedCloud, data: bytes, points: Points) -> None:
    raw = zlib.decompressobj().decompress(data, MAX_BYTES)
    at = 0
    for field in head.fields:
        shape = len(points), field.count
        if field.datatype < 7 or field.name in COLORS:
            values, at = _read(raw, at, TYPES[field.datatype], shape)
            points[field.name] = values
            continue
        (low, high), at = _read(raw, at, "<f8", (2,))
        steps = _steps(field)
        whole, at = _read(raw, at, steps.dtype, shape)
        scaled = low + whole / (steps.max - 1) * (high - low)
        points[field.name] = np.where(whole == steps.max, np.nan, scaled)


def _read(raw: bytes, at: int, kind: Any, shape: tuple[int, ...]) -> tuple[NDArray[Any], int]:
    values = np.frombuffer(raw, kind, int(np.prod(shape)), at).reshape(shape)
    return values, at + values.nbytes


def _steps(field: CloudField) -> np.iinfo[Any]:
    return np.iinfo(np.dtype("<u2" if field.datatype == 7 else "<u4"))


def _pack_draco(head: PackedCloud, points: Points) -> tuple[PackedCloud, bytes]:
    import DracoPy  # the extra `draco`

    names = [field.name for field in head.fields]
    if not {"x", "y", "z"} <= set(names) or any(each.datatype != 7 for each in head.fields if each.name in "xyz"):
        raise ConversionError("draco takes clouds with x, y and z as float32: use quantised", field="fields")
    places = np.concatenate([points[axis] for axis in "xyz"], axis=1)
    kept = np.isfinite(places).all(axis=1)
    points, places = points[kept], np.ascontiguousarray(places[kept], np.float32)
    attributes = {name: _attribute(head, name, points[name]) for name in names if name not in "xyz"}
    flat = msgspec.structs.replace(head, height=1, width=len(points), is_dense=True)
    if not len(points):
        return flat, b""
    return flat, DracoPy.encode(places, quantization_bits=DRACO_BITS, generic_attributes=attributes or None)


def _attribute(head: PackedCloud, name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Return a field in a type that Draco has; colours and integers of 32 bits as bytes of the same value."""
    if name in COLORS:
        return np.ascontiguousarray(values).view(np.uint32)
    if values.dtype.str in ("<f8", "<i4", "<i2", "|i1"):
        raise ConversionError(f"draco has no type for the field {name[:40]}: use quantised", field="fields")
    return np.ascontiguousarray(values)


def _unpack_draco(head: PackedCloud, data: bytes, points: Points) -> None:
    import DracoPy  # the extra `draco`

    if not len(points):
        return
    found = DracoPy.decode(data)
    if len(found.points) != len(points):
        raise ValueError(f"{len(found.points)} points instead of {len(points)}")
    for field in head.fields:
        if field.name in ("x", "y", "z"):
            points[field.name] = found.points[:, "xyz".index(field.name), None]
        else:
            values = np.asarray(found.get_attribute_by_name(field.name)["data"])
            kind = np.dtype(TYPES[field.datatype])
            points[field.name] = values.view(kind) if field.name in COLORS else values.astype(kind)


def empty_head(header: Header, codec: str, points: Points) -> PackedCloud:
    """Return the head of points in one row, with the layout of their type."""
    kinds = {np.dtype(text): number for number, text in TYPES.items()}
    fields = [
        CloudField(name, offset, kinds[kind.base], int(np.prod(kind.shape or (1,))))
        for name, (kind, offset, *_) in (points.dtype.fields or {}).items()
    ]
    size = points.dtype.itemsize
    return PackedCloud(header=header, codec=codec, width=len(points), fields=fields, point_step=size)
