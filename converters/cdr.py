"""Messages as they are: the blob of a message is its CDR."""

from __future__ import annotations

from uuid import uuid4

from converters.codec import Recipe
from converters.ros1 import one_blob
from converters.wire import Buffer, Wire

CDR = "cdr"  # the format of interfaces


class CdrCodec:
    """Codec of Forwarders, for which the blob of a message is its CDR.

    Attributes:
        recipe: What another process needs to make the same codec.
    """

    def __init__(self, recipe: Recipe) -> None:
        self.recipe = recipe

    def encodes_fast(self, wire: Wire) -> bool:
        """Return True: nothing is converted."""
        return True

    def decodes_fast(self, cdr: Buffer) -> bool:
        """Return True: nothing is converted."""
        return True

    def encode(self, wire: Wire) -> Buffer:
        """Return the blob of a message; raise InvalidRequest if it is not exactly one blob."""
        return one_blob(wire)

    def decode(self, cdr: Buffer) -> Wire:
        """Return the CDR as a blob with a new id."""
        name = uuid4().hex
        return Wire(True, b'"%b"' % name.encode(), {name: cdr})
