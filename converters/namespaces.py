"""Messages of one type as namespaces of their fields, for functions on NumPy arrays."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from msgspec import UNSET

from converters.codec import HEADER, LITTLE_ENDIAN
from converters.model import Message
from converters.reader import Readers
from converters.scalars import FieldError
from converters.wire import Buffer, Incoming, Outgoing
from converters.writer import Writers

Fields = Any  # a SimpleNamespace; messages inside are structs, byte arrays views of the CDR, other arrays lists


class Namespaces:
    """Conversion of a type between CDR and namespaces."""

    def __init__(self, message: Message) -> None:
        self._names = {member.attr: member.field.name for member in message.members}
        self._blobs = {member.attr + "b": UNSET for member in message.members if member.accepts_blob}
        self._read = Readers("json", number=lambda value: value).top(message)
        self._write = Writers().top(message)

    def read(self, cdr: Buffer) -> Fields:
        """Return the fields of a message; raises FieldError."""
        data = memoryview(cdr).cast("B")
        if data[:2] != LITTLE_ENDIAN:
            raise FieldError("it does not begin as plain little-endian CDR")
        found, _ = self._read(data[4:], 0, Outgoing())
        return SimpleNamespace(**{name: getattr(found, attr) for attr, name in self._names.items()})

    def write(self, fields: Fields) -> bytes:
        """Return a message as CDR; raises FieldError."""
        parts: list[Buffer] = [HEADER]
        values = {attr: getattr(fields, name) for attr, name in self._names.items()}
        self._write(SimpleNamespace(**values, **self._blobs), parts, 0, Incoming({}))  # type: ignore[arg-type]
        return b"".join(parts)
