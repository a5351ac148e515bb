"""Codecs of smaller messages: some fields only, or fewer beams, pixels and points.

A message is made smaller before it is converted. JSON and CBOR have the wanted fields only; other forms, which have all
fields of their type, have defaults in place of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import msgspec

from converters.codec import Codec, Recipe
from converters.decimation import Decimator
from converters.model import Message
from converters.packed import PackedCodec
from converters.reader import Readers
from converters.selection import select
from converters.wire import Buffer, Wire
from converters.writer import Writers
from rce.protocol.messages import Decimation

ALL = Decimation()


class AnyCodec(Protocol):
    """A codec of any form."""

    @property
    def recipe(self) -> Recipe:
        """Return the description from which a worker makes the same codec."""

    def encode(self, wire: Wire) -> Buffer:
        """Convert a message of the robot to CDR."""

    def decode(self, cdr: Buffer) -> Wire:
        """Convert CDR to a message for the robot."""

    def encodes_fast(self, wire: Wire) -> bool:
        """Return True if `encode` takes a few milliseconds at most."""

    def decodes_fast(self, cdr: Buffer) -> bool:
        """Return True if `decode` takes a few milliseconds at most."""


class Projector:
    """Function from CDR to CDR of the same type, in which all but some fields have their defaults."""

    def __init__(self, message: Message, fields: Sequence[str]) -> None:
        """Make a projector; raises InvalidRequest if the type has no such field."""
        self._codec = Codec(select(message, fields), Writers(), Readers("json"), Recipe(message.name, "json"))

    def __call__(self, cdr: Buffer) -> Buffer:
        """Return the smaller message; raises ConversionError."""
        return self._codec.encode(self._codec.decode(cdr))


class ReducedCodec:
    """Codec that makes each message for the robot smaller before another codec converts it.

    Attributes:
        recipe: What another process needs to make the same codec.
    """

    def __init__(self, codec: Codec, form: AnyCodec, fields: Sequence[str], decimate: Decimation) -> None:
        """Make a codec.

        Args:
            codec: Codec of the type as JSON or CBOR.
            form: Codec of the form in which the robot gets messages; may be the same.
            fields: Paths of the wanted fields; empty for all.
            decimate: Decimation.

        Raises:
            InvalidRequest: The type has no such field, or cannot be decimated in this way.
        """
        self.recipe = msgspec.structs.replace(form.recipe, fields=tuple(fields), decimate=decimate)
        self._codec, self._form = codec, form
        self._decimator = None if decimate == ALL else Decimator(codec.message, decimate.step, decimate.size)
        self._projector = Projector(codec.message, fields) if fields and form is not codec else None
        if fields and form is codec:
            self._form = _projected(codec, fields)

    def request_key(self) -> None:
        """Make the next packet of video a key frame."""
        if isinstance(self._form, PackedCodec):
            self._form.request_key()

    def encodes_fast(self, wire: Wire) -> bool:
        """Return True if `encode` takes a few milliseconds at most."""
        return self._form.encodes_fast(wire)

    def decodes_fast(self, cdr: Buffer) -> bool:
        """Return True if `decode` takes a few milliseconds at most."""
        return self._codec.decodes_fast(cdr) and self._form.decodes_fast(cdr)

    def encode(self, wire: Wire) -> Buffer:
        """Convert a message of the robot to CDR, as a whole."""
        return self._form.encode(wire)

    def decode(self, cdr: Buffer) -> Wire:
        """Convert CDR to a smaller message for the robot; raises ConversionError."""
        if self._decimator is not None:
            cdr = self._decimator(cdr)
        if self._projector is not None:
            cdr = self._projector(cdr)
        return self._form.decode(cdr)


def _projected(codec: Codec, fields: Sequence[str]) -> Codec:
    recipe = codec.recipe
    message = select(codec.message, fields, pictures=recipe.image_format != "json")
    return Codec(message, Writers(), Readers(recipe.image_format, dialect=recipe.dialect), recipe)
