"""Channels of packets: images as video and clouds by Draco, in the types that viewers decode."""

from __future__ import annotations

import msgspec
from msgspec import Struct

from converters import TypeRegistry, Wire
from endpoints.gateways.guest import BLOB
from endpoints.gateways.uses import Arrived
from rce.codecs.names import CLOUD, COLOR, DRACO, FOXGLOVE, FOXGLOVE_CLOUD, IMAGE
from rce.codecs.packed import Header
from rce.protocol.names import parse_type

TYPES = {**dict.fromkeys(COLOR, (IMAGE, FOXGLOVE)), DRACO: (CLOUD, FOXGLOVE_CLOUD)}
"""Type of the topics that a codec packs, and type of its packets, by codec."""


class _Head(Struct, frozen=True):
    header: Header


class _Packet(Struct, frozen=True):
    timestamp: object
    frame_id: str
    format: str
    blob: str = msgspec.field(default=BLOB, name="data*")


class Packing:
    """Form of the packets of a codec for a viewer."""

    def __init__(self, codec: str) -> None:
        self._codec = codec
        self._message = TypeRegistry().message(parse_type(TYPES[codec][1]))

    def cdr(self, arrived: Arrived) -> bytes:
        """Return a packet as CDR of its type."""
        assert arrived.blob is not None
        header = msgspec.json.decode(memoryview(arrived.value)[:-1], type=_Head).header
        packet = _Packet(header.stamp, header.frame_id, self._codec)
        return self._message.encode(Wire(False, msgspec.json.encode(packet), {BLOB: arrived.blob}))
