"""Converters of users: code that gives messages of one type another form at robots.

A user's converter sees the fields of a message, not CDR. `custom_files` finds converters.
"""

from __future__ import annotations

import traceback
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, NoReturn

import msgspec

from converters.codec import HEADER, LITTLE_ENDIAN, Codec
from converters.reader import Readers
from converters.scalars import FieldError
from converters.wire import Buffer, Incoming, Outgoing, Wire
from converters.writer import MAX_CDR, Writers
from rce.errors import ConversionError, InvalidRequest

BYTES = (bytes, bytearray, memoryview)


class Converter(ABC):
    """Base of users' converters. The platform makes one instance in each process that converts.

    A ValueError that a method raises is sent to the robot with its text; other exceptions are sent with file and line.

    Attributes:
        name: Value of `format` with which an interface chooses this converter.
        type: Type of the messages, `pkg/Name`.
        default: Interfaces without a `format` use it too, as those of robots of the original.
    """

    name: ClassVar[str]
    type: ClassVar[str]
    default: ClassVar[bool] = False

    @abstractmethod
    def from_robot(self, value: Any) -> Mapping[str, object]:
        """Return the fields of a message of the robot.

        Fields that are left out have their defaults. Byte arrays may be bytes, arrays of numbers lists or NumPy arrays.

        Args:
            value: Bytes, if the robot has sent a blob (`msg*`), else the decoded JSON of `msg`.
        """

    @abstractmethod
    def to_robot(self, message: dict[str, Any]) -> object:
        """Return the form of a message for the robot: bytes, which become a blob, or anything that JSON can hold.

        Args:
            message: All fields; messages inside are dicts too, byte arrays are memoryviews.
        """


class CustomCodec:
    """Codec of a type that uses a user's converter.

    Attributes:
        recipe: What another process needs to make the same codec.
    """

    def __init__(self, codec: Codec, converter: Converter) -> None:
        self.recipe = msgspec.structs.replace(codec.recipe, converter=converter.name)
        self._message = codec.message
        self._converter = converter
        self._write = Writers().top(codec.message)
        self._read = Readers("json", number=_unchanged).top(codec.message)

    def encodes_fast(self, wire: Wire) -> bool:
        """Return False: nobody knows how long it takes."""
        return False

    def decodes_fast(self, cdr: Buffer) -> bool:
        """Return False: nobody knows how long it takes."""
        return False

    def encode(self, wire: Wire) -> bytes:
        """Convert a message of the robot to CDR.

        Raises:
            ConversionError: The converter refuses the message or fails, or what it returns does not fit the type.
        """
        value = self._value(wire)
        try:
            fields = self._converter.from_robot(value)
        except Exception as error:  # noqa: BLE001  # whatever it is belongs to this message
            self._refuse(error)
        parts: list[Buffer] = [HEADER]
        try:
            plain = msgspec.to_builtins(fields, builtin_types=BYTES, enc_hook=_plain)
            size = self._write(msgspec.convert(plain, self._message.model), parts, 0, Incoming({}))
            if size > MAX_CDR:
                raise FieldError(f"the message is larger than {MAX_CDR} bytes in CDR")
        except FieldError as error:
            self._refuse_result("from_robot", f"{error.path}: {error.reason}")
        except (TypeError, ValueError, RecursionError) as error:
            self._refuse_result("from_robot", str(error))
        return b"".join(parts)

    def decode(self, cdr: Buffer) -> Wire:
        """Convert CDR to the form of the robot.

        Raises:
            ConversionError: The bytes are not CDR of the type, or the converter fails.
        """
        data = memoryview(cdr).cast("B")
        try:
            if data[:2] != LITTLE_ENDIAN:
                raise FieldError("it does not begin as plain little-endian CDR")
            message, _ = self._read(data[4:], 0, Outgoing())
        except FieldError as error:
            raise ConversionError(f"{self._message.name} {error.path}: {error.reason}", field=error.path) from error
        try:
            value = self._converter.to_robot(msgspec.to_builtins(message, builtin_types=BYTES))
        except Exception as error:  # noqa: BLE001  # whatever it is belongs to this message
            self._refuse(error)
        if isinstance(value, BYTES):
            blobs = Outgoing()
            return Wire(True, b'"%b"' % blobs.add(value).encode(), blobs)
        try:
            return Wire(False, msgspec.json.encode(value, enc_hook=_plain), {})
        except (TypeError, ValueError, RecursionError) as error:
            self._refuse_result("to_robot", str(error))

    def _value(self, wire: Wire) -> object:
        if wire.is_blob and len(wire.blobs) == 1:
            return bytes(next(iter(wire.blobs.values())))
        if wire.is_blob or wire.blobs:
            raise InvalidRequest(f"the converter {self._converter.name} takes one blob (msg*) or JSON", field="msg")
        try:
            return msgspec.json.decode(wire.raw)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise ConversionError(f"{self._message.name}: the message is not JSON: {error}") from error

    def _refuse(self, error: Exception) -> NoReturn:
        raise ConversionError(f"{self._place}: {_text(error)}") from error

    def _refuse_result(self, method: str, reason: str) -> NoReturn:
        raise ConversionError(f"{self._place}: what its {method} returned does not fit the type: {reason[:200]}")

    @property
    def _place(self) -> str:
        return f"{self._message.name}: converter {self._converter.name}"


def _unchanged(value: float) -> float:
    return value


def _plain(value: object) -> object:
    """Return a NumPy array as a list, and one of its numbers as a number."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"a value is a {type(value).__name__}")


def _text(error: Exception) -> str:
    if type(error) is ValueError:
        return str(error)[:200]
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(last.filename).name}, line {last.lineno}: {type(error).__name__}: {str(error)[:200]}"
