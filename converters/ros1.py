"""Serialized messages of ROS 1 to CDR and back.

ROS 1 (wiki.ros.org/msg, "Serialization") is little endian too, but packs the fields without alignment, ends no string
with a zero, and begins with no header. Nothing is deserialized: scalars and arrays are copied to where they belong.
The definition of a type is that of ROS 2; `ros1_steps` says how those of ROS 1 Noetic differ. Custom types
have the same fields in both.

rosbags has such a conversion too. It is not made for bytes of strangers: it steps through as many messages as a length
says, before it looks whether there are so many (4 bytes kept it busy for minutes), and it makes code for each element
of an array.
"""

from __future__ import annotations

from typing import NoReturn
from uuid import uuid4

import msgspec

from converters.codec import Codec
from converters.definition import STRINGS, Shape
from converters.model import Message
from converters.ros1_steps import Compiler
from converters.scalars import FieldError
from converters.wire import Buffer, Wire
from converters.writer import MAX_CDR
from rce.errors import ConversionError, InvalidRequest

ROS1 = "ros1"  # the format of interfaces
FAST_COPY, FAST_PARTS = 1 << 22, 1 << 15  # bytes that are converted within a few milliseconds
ENCAPSULATION = b"\x00\x01\x00\x00"  # plain little-endian CDR


class Ros1Codec:
    """Codec of Forwarders whose blobs are serialized by ROS 1.

    Attributes:
        recipe: What another process needs to make the same codec.
    """

    def __init__(self, codec: Codec) -> None:
        """Compile the codec for the type of another.

        Raises:
            InvalidRequest: ROS 1 has no such type.
        """
        message = codec.message
        self.recipe = msgspec.structs.replace(codec.recipe, converter=ROS1)
        self._name = message.name
        self._to_cdr = Compiler(to_cdr=True).chain(message)
        self._from_cdr = Compiler(to_cdr=False).chain(message)
        self._fast_size = FAST_PARTS if _has_parts(message) else FAST_COPY

    def encodes_fast(self, wire: Wire) -> bool:
        """Return True if `encode` takes a few milliseconds at most."""
        return sum(map(len, wire.blobs.values())) <= self._fast_size

    def decodes_fast(self, cdr: Buffer) -> bool:
        """Return True if `decode` takes a few milliseconds at most."""
        return len(cdr) <= self._fast_size

    def encode(self, wire: Wire) -> bytes:
        """Convert the blob of a message to CDR.

        Raises:
            InvalidRequest: The message is not exactly one blob.
            ConversionError: The blob is not the ROS 1 form of the type; `field` is the path of the field at fault.
        """
        data = memoryview(one_blob(wire)).cast("B")
        parts: list[Buffer] = [ENCAPSULATION]
        try:
            at, size = self._to_cdr(data, 0, parts, 0)
            if at < len(data):
                raise FieldError(f"{len(data) - at} bytes follow the message")
            if size > MAX_CDR:
                raise FieldError(f"the message is larger than {MAX_CDR} bytes in CDR")
        except FieldError as error:
            self._refuse(error, f"the blob is not this type as ROS 1 serializes it{_guess(data)}")
        return b"".join(parts)

    def decode(self, cdr: Buffer) -> Wire:
        """Convert CDR to a blob with a new id.

        Raises:
            ConversionError: The bytes are not CDR of the type.
        """
        data = memoryview(cdr).cast("B")
        parts: list[Buffer] = []
        try:
            if data[:2] != ENCAPSULATION[:2]:
                raise FieldError("it does not begin as plain little-endian CDR")
            self._from_cdr(data[4:], 0, parts, 0)
        except FieldError as error:
            self._refuse(error, "the message is not CDR of this type")
        name = uuid4().hex
        return Wire(True, b'"%b"' % name.encode(), {name: b"".join(parts)})

    def _refuse(self, error: FieldError, what: str) -> NoReturn:
        place = f"{self._name} {error.path}" if error.path else self._name
        raise ConversionError(f"{place}: {what}: {error.reason}", field=error.path) from error


def one_blob(wire: Wire) -> Buffer:
    """Return the blob of a Forwarder's message; raise InvalidRequest if it is not exactly one."""
    if not wire.is_blob or len(wire.blobs) != 1:
        raise InvalidRequest("the message of a Forwarder must be one blob: send msg* with the blob's id", field="msg")
    return next(iter(wire.blobs.values()))


def _guess(data: memoryview) -> str:
    if data[:4] == ENCAPSULATION:
        return " (it begins like CDR of ROS 2: if it is, remove the format ros1 of the interface)"
    if bytes(data[:1]) == b"x" and int.from_bytes(data[:2], "big") % 31 == 0:  # RFC 1950, section 2.2
        return " (it begins like zlib: set gzip_lvl to 0 at the robot)"
    return ""


def _has_parts(message: Message) -> bool:
    """Return True if a message may have many strings or messages."""
    return any(
        (m.type.shape is not Shape.SINGLE and (m.message is not None or m.type.base in STRINGS))
        or (m.message is not None and _has_parts(m.message))
        for m in message.members
    )
