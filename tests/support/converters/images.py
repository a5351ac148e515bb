"""Images and image files for the tests of the converters."""

from __future__ import annotations

import base64
import json
import struct
from typing import Any
from zlib import compress, crc32

import numpy as np

from converters import Codec, TypeRegistry, Wire
from converters.images import ENCODINGS
from rce.protocol.names import parse_type

BLOB = "0123456789abcdef0123456789abcdef"
RNG = np.random.default_rng(1)


def image_codec(registry: TypeRegistry, image_format: Any = "png", name: str = "sensor_msgs/Image") -> Codec:
    return registry.message(parse_type(name), image_format)


def cdr_of(registry: TypeRegistry, pixels: np.ndarray, encoding: str, padding: int = 0, /, **fields: object) -> bytes:
    """Return an Image message in CDR with `padding` bytes at the end of each row."""
    rows = pixels.reshape(len(pixels), -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    value = {"height": len(pixels), "width": pixels.shape[1], "encoding": encoding, "step": rows.shape[1], **fields}
    blob = Wire(False, json.dumps(value | {"data*": BLOB}).encode(), {BLOB: rows.tobytes()})
    return image_codec(registry, "json").encode(blob)


def fields(registry: TypeRegistry, cdr: bytes) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(bytes(image_codec(registry, "json").decode(cdr).raw))
    return found


def image_wire(blob: bytes) -> Wire:
    """Return the payload of a message that is one image file."""
    return Wire(True, f'"{BLOB}"'.encode(), {BLOB: blob})


def image_blob(wire: Wire) -> bytes:
    """Return the image file of a payload."""
    assert wire.is_blob
    return bytes(wire.blobs[json.loads(bytes(wire.raw))])


def random_pixels(encoding: str) -> np.ndarray:
    kind = ENCODINGS[encoding]
    shape = (5, 7, kind.channels) if kind.channels > 1 else (5, 7)
    return RNG.integers(0, 256**kind.depth, shape).astype(f"<u{kind.depth}")


def data_of(found: dict[str, Any]) -> bytes:
    return base64.b64decode(found["data"])


def png(width: int, height: int, bits: int = 8, colour: int = 0, data: bytes = b"") -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", crc32(kind + body))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", compress(data)) + chunk(b"IEND", b"")


def jpeg(width: int, height: int) -> bytes:
    return b"\xff\xd8\xff\xe0\0\4ab\xff\xc2" + struct.pack(">HBHHB", 8, 8, height, width, 3) + b"\xff\xda\0\2"
