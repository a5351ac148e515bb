"""Calls and their answers in Banana, encoded and decoded as a whole: item by item takes three times as long.

    [message, request, receiver, "call", 1, [tuple, page, ...], [dictionary]]
    [answer, request, [tuple, page, ...]]

Words such as `message` are of the vocabulary of Perspective Broker.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final, NamedTuple

from twisted.spread import banana

NO_KEYWORDS: Final = [b"dictionary"]  # part of each call
_BASE: Final = 128  # numbers are written to this base, the lowest digit first
_WORDS = {word: bytes((number,)) + banana.VOCAB for word, number in banana.Banana.outgoingVocabulary.items()}
_NUMBER: Final = rb"([\x00-\x7f]{1,5})"

_CALL: Final = b"\x07" + banana.LIST + _WORDS[b"message"]
_METHOD: Final = b"\x04" + banana.STRING + b"call" + b"\x01" + banana.INT
_END_OF_CALL: Final = b"\x01" + banana.LIST + _WORDS[b"dictionary"]
_ANSWER: Final = b"\x03" + banana.LIST + _WORDS[b"answer"]
_ONE_PAGE: Final = b"\x02" + banana.LIST + _WORDS[b"tuple"]
_CALL_ITEMS, _ANSWER_ITEMS = 11, 6
_CALL_START = re.compile(
    re.escape(_CALL) + (_NUMBER + re.escape(banana.INT)) * 2 + re.escape(_METHOD + _ONE_PAGE) + _NUMBER + banana.STRING
)
_ANSWER_START = re.compile(re.escape(_ANSWER) + _NUMBER + re.escape(banana.INT + _ONE_PAGE) + _NUMBER + banana.STRING)


class Decoded(NamedTuple):
    """A message, the number of its items, and the index in the buffer at which it ends."""

    message: list[object]
    items: int
    end: int


def encode_call(request: int, receiver: int, pages: Sequence[bytes]) -> bytes:
    """Encode a call of the object with the id `receiver`."""
    ids = _number(request) + banana.INT + _number(receiver) + banana.INT
    return b"".join((_CALL, ids, _METHOD, *_tuple(pages), _END_OF_CALL))


def encode_answer(request: int, pages: Sequence[bytes]) -> bytes:
    """Encode the answer to a call."""
    return b"".join((_ANSWER, _number(request), banana.INT, *_tuple(pages)))


def pages_of(part: object) -> tuple[bytes, ...] | None:
    """Return the pages in a part of a message; None if it is something else."""
    if type(part) is not list or part[:1] != [b"tuple"] or not all(type(each) is bytes for each in part):
        return None
    return tuple(part[1:])


def decode(buffer: bytearray, start: int) -> Decoded | None:
    """Decode the call or answer of one page that begins at index `start`; None if it is incomplete, or another one."""
    if (found := _CALL_START.match(buffer, start)) is not None:
        request, receiver, size = map(decode_number, found.groups())
        page, end = found.end(), found.end() + size
        if size > banana.SIZE_LIMIT or not buffer.startswith(_END_OF_CALL, end):
            return None
        message = [b"message", request, receiver, b"call", 1, [b"tuple", bytes(buffer[page:end])], [*NO_KEYWORDS]]
        return Decoded(message, _CALL_ITEMS, end + len(_END_OF_CALL))
    if (found := _ANSWER_START.match(buffer, start)) is not None:
        request, size = map(decode_number, found.groups())
        page, end = found.end(), found.end() + size
        if size > banana.SIZE_LIMIT or len(buffer) < end:
            return None
        return Decoded([b"answer", request, [b"tuple", bytes(buffer[page:end])]], _ANSWER_ITEMS, end)
    return None


def decode_number(digits: bytes | bytearray) -> int:
    """Decode a number."""
    number = 0
    for digit in reversed(digits):
        number = number * _BASE + digit
    return number


def _tuple(pages: Sequence[bytes]) -> list[bytes]:
    parts = [_number(1 + len(pages)), banana.LIST, _WORDS[b"tuple"]]
    for page in pages:
        parts += (_number(len(page)), banana.STRING, page)
    return parts


def _number(value: int) -> bytes:
    if value < _BASE:
        return bytes((value,))
    digits = bytearray()
    while value:
        value, digit = divmod(value, _BASE)
        digits.append(digit)
    return bytes(digits)
