"""Payloads of the benchmark: sizes, and the value that a robot sends for each form of a message."""

from __future__ import annotations

import base64
import functools
import struct
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from rce.errors import InvalidRequest

SMALLEST, LARGEST = 10, 10_000_000
WIDTH, HEIGHT = 640, 480
ROW = 3 * WIDTH
IMAGE = ROW * HEIGHT  # bytes of an rgb8 image
CDR = b"\0\1\0\0"  # the encapsulation header of little-endian CDR (RTPS 2.5, 10.2)

SERVICE_TYPE = "diagnostic_msgs/AddDiagnostics"


def sizes(count: int) -> list[int]:
    """Return `count` sizes in bytes from 10 B to 10 MB, log-uniform, both ends included.

    Raises:
        InvalidRequest: `count` is less than 2.
    """
    if count < 2:
        raise InvalidRequest(f"the number of sizes is {count}; it must be at least 2", field="sizes")
    return [round(SMALLEST * (LARGEST / SMALLEST) ** (index / (count - 1))) for index in range(count)]


class Payload(NamedTuple):
    """One form in which a robot sends a message of a topic and receives it back.

    `make` and `read` are part of the measured time, since a robot has to do this work; work that it would not do is
    cached.

    Attributes:
        name: Name of the form.
        type_name: Type of the message.
        kind: Name of the type in the nodes.
        make: Returns the value that carries a number of bytes.
        read: Returns the content of the answer.
        raw: Whether messages are raw CDR.
        format: Format of images in the answer.
    """

    name: str
    type_name: str
    kind: str
    make: Callable[[int], Any]
    read: Callable[[Any], Any]
    raw: bool = False
    format: Literal["png", "json"] = "png"


class Call(NamedTuple):
    """One form in which a robot calls a service that returns the string of the request; see `Payload`."""

    name: str
    make: Callable[[int], Any]
    read: Callable[[Any], Any]
    raw: bool = False


@functools.lru_cache(2)
def text(size: int) -> str:
    """Return a string of `size` characters."""
    return "x" * size


@functools.lru_cache(2)
def data(size: int) -> bytes:
    """Return `size` zero bytes."""
    return bytes(size)


@functools.lru_cache(2)
def string_cdr(size: int) -> bytes:
    """Return the CDR of a message whose only field is a string of `size` characters."""
    return b"".join((CDR, struct.pack("<I", size + 1), text(size).encode(), b"\0"))


@functools.lru_cache(2)
def bytes_cdr(size: int) -> bytes:
    """Return the CDR of a `std_msgs/UInt8MultiArray` without dimensions."""
    return b"".join((CDR, struct.pack("<III", 0, 0, size), data(size)))


@functools.lru_cache(2)
def image_cdr(size: int) -> bytes:
    """Return the CDR of a `sensor_msgs/Image`, rgb8 with 640 columns, without stamp and frame."""
    head = struct.pack("<iII4sIII5s3xII", 0, 0, 1, b"\0", size // ROW, WIDTH, 5, b"rgb8\0", ROW, size)
    return b"".join((CDR, head, data(size)))


def image_json(size: int) -> dict[str, Any]:
    """Return a `sensor_msgs/Image` as JSON, rgb8 with 640 columns."""
    pixels = base64.b64encode(data(size)).decode()
    return {"height": size // ROW, "width": WIDTH, "encoding": "rgb8", "step": ROW, "data": pixels}


def _same(answer: bytes) -> bytes:
    return answer


def _decoded(answer: dict[str, str]) -> bytes:
    return base64.b64decode(answer["data"])


TOPICS = (
    Payload("json", "std_msgs/String", "string", lambda size: {"data": text(size)}, lambda answer: answer["data"]),
    Payload("blob", "std_msgs/UInt8MultiArray", "bytes", lambda size: {"data": data(size)}, _decoded),
    Payload("forwarder", "std_msgs/UInt8MultiArray", "bytes", bytes_cdr, _same, raw=True),
)
IMAGES = (
    Payload("image_forwarder", "sensor_msgs/Image", "image", image_cdr, _same, raw=True),
    Payload("image_json", "sensor_msgs/Image", "image", image_json, _decoded, format="json"),
)
SERVICES = (
    Call("json", lambda size: {"load_namespace": text(size)}, lambda answer: answer["message"]),
    Call("forwarder", string_cdr, _same, raw=True),
)
