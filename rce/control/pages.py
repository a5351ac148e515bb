"""What control connections carry: calls and answers as msgpack, in pages.

Perspective Broker refuses strings of more than 640 KiB, so a message is split. It encodes each of its values in Python,
so a call is one string, and so is its answer, unless they are larger than a page.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

import msgspec
from msgspec import Raw, Struct

from rce.control.limits import MAX_MESSAGE
from rce.errors import MALFORMED, LimitExceeded

PAGE_SIZE = 500_000  # bytes
OVERHEAD = 1000  # bytes of a message beside the encoded value
MALFORMED_PAGES = (*MALFORMED, TypeError)  # raised by `decode_pages`

Pages = list[bytes]
T = TypeVar("T")


class Question(Struct, frozen=True, array_like=True):
    """Call of the peer.

    Attributes:
        name: Name of the call's type.
        request: Id of the robot's command or HTTP request that caused it, for the log; empty for none.
        term: Term of the Master that leads, as the sender knows it; 0 if it does not.
        call: The call.
    """

    name: str
    request: str
    term: int
    call: Raw


class Answer(Struct, frozen=True, array_like=True):
    """Answer to a call: its result if it is `good`, else an ErrorInfo."""

    good: bool
    value: Raw


def encode(value: Struct, max_size: int = MAX_MESSAGE) -> Raw:
    """Encode a value as msgpack.

    Raises:
        LimitExceeded: It is larger than the peer accepts.
    """
    data = msgspec.msgpack.encode(value)
    if len(data) > max_size - OVERHEAD:
        raise LimitExceeded(
            f"{type(value).__name__} has {len(data)} bytes, more than the {max_size - OVERHEAD} that a process of this "
            "role may send: ask for less at a time"
        )
    return Raw(data)


def encode_pages(value: Struct) -> Pages:
    """Encode a value as msgpack, split into pages that Perspective Broker accepts."""
    data = msgspec.msgpack.encode(value)
    return [data[start : start + PAGE_SIZE] for start in range(0, len(data), PAGE_SIZE)]


def decode_pages(pages: Iterable[bytes], kind: type[T]) -> T:
    """Decode pages as a `kind`.

    Raises:
        msgspec.DecodeError: The pages are not a `kind`.
        TypeError: The pages are not a list of bytes.
        RecursionError: They are nested too deeply.
    """
    return msgspec.msgpack.decode(b"".join(pages), type=kind)
