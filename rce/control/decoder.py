"""Decoder of Banana, the encoding of Perspective Broker, with limits for each message.

Twisted's decoder copies the rest of its buffer for each item, so its time is quadratic in the size of a message, and it
limits neither the number of items and their nesting nor the total size.
"""

from __future__ import annotations

import re
import struct
from typing import Final

from twisted.spread import banana

from rce.control import messages

MAX_DEPTH = 32  # nested lists
MAX_PREFIX = 64  # bytes of a number
INCOMPLETE: Final = object()
_BEGUN: Final = object()  # the beginning of a list
_TYPES = 0x80  # bytes from this one on are types, those below it digits of numbers
_LIST, _INT, _STRING, _NEG, _FLOAT, _LONG, _LONG_NEG, _VOCAB = (
    kind[0]
    for kind in (
        *(banana.LIST, banana.INT, banana.STRING, banana.NEG),
        *(banana.FLOAT, banana.LONGINT, banana.LONGNEG, banana.VOCAB),
    )
)
_TYPE_BYTE = re.compile(rb"[\x80-\xff]")
_WORDS: dict[int, bytes] = banana.Banana.incomingVocabulary


class MalformedMessage(Exception):
    """The received bytes are no message, or one beyond the limits."""


class Decoder:
    """Incremental decoder; its time is linear in the number of received bytes.

    Attributes:
        max_bytes: Limit of the size of a message.
        max_items: Limit of the number of lists, strings and numbers in a message.
        size: Bytes of the last complete message.
        items: Items of the last complete message.
    """

    def __init__(self, max_bytes: int, max_items: int) -> None:
        self.max_bytes = max_bytes
        self.max_items = max_items
        self.size = self.items = 0
        self._buffer = bytearray()
        self._position = 0
        self._taken = 0  # bytes of the present message that are decoded
        self._count = 0  # items of the present message
        self._open: list[tuple[int, list[object]]] = []  # unfinished lists, with their lengths

    def feed(self, data: bytes) -> None:
        """Add received bytes."""
        del self._buffer[: self._position]
        self._position = 0
        self._buffer += data

    def next(self) -> object:
        """Return the next message, or INCOMPLETE.

        Raises:
            MalformedMessage: The bytes are malformed, or the message exceeds a limit.
        """
        lists = self._open
        if not lists:
            if self._position == len(self._buffer):
                return INCOMPLETE
            if (whole := messages.decode(self._buffer, self._position)) is not None:
                self._taken = whole.end - self._position
                self._position = whole.end
                self._add_items(whole.items)
                return self._complete(whole.message)
        while (item := self._item()) is not INCOMPLETE:
            if item is _BEGUN:
                length, item = lists[-1]
                if length:
                    continue
                lists.pop()
            while lists:
                length, innermost = lists[-1]
                innermost.append(item)
                if len(innermost) < length:
                    break
                item = innermost
                lists.pop()
            else:
                return self._complete(item)
        if self._taken + len(self._buffer) - self._position > self.max_bytes:
            raise MalformedMessage("a message is too large")
        return INCOMPLETE

    def _add_items(self, count: int) -> None:
        self._count += count
        if self._count > self.max_items:
            raise MalformedMessage("a message has too many items")

    def _complete(self, message: object) -> object:
        self.size, self.items = self._taken, self._count
        self._taken = self._count = 0
        if self.size > self.max_bytes:
            raise MalformedMessage("a message is too large")
        return message

    def _item(self) -> object:
        """Decode the next string or number, or begin a list: then return _BEGUN."""
        buffer, start = self._buffer, self._position
        if len(buffer) > start + 1 and buffer[start] < _TYPES <= buffer[start + 1]:  # most numbers have one digit
            end, number = start + 2, buffer[start]
        elif (found := _TYPE_BYTE.search(buffer, start, start + MAX_PREFIX + 1)) is not None:
            end = found.end()
            number = messages.decode_number(buffer[start : end - 1])
        elif len(buffer) - start > MAX_PREFIX:
            raise MalformedMessage("a number is too long")
        else:
            return INCOMPLETE
        kind = buffer[end - 1]
        body = number if kind == _STRING else 8 if kind == _FLOAT else 0
        if body > banana.SIZE_LIMIT:
            raise MalformedMessage("a string is too long")
        after = end + body
        if len(buffer) < after:
            return INCOMPLETE
        self._add_items(1)
        self._position = after
        self._taken += after - start
        if kind == _STRING:
            return bytes(buffer[end:after])
        if kind == _LIST:
            self._begin(number)
            return _BEGUN
        if kind == _VOCAB and number in _WORDS:
            return _WORDS[number]
        if kind in (_INT, _LONG):
            return number
        if kind in (_NEG, _LONG_NEG):
            return -number
        if kind == _FLOAT:
            return struct.unpack("!d", buffer[end:after])[0]
        raise MalformedMessage("it is no message of Perspective Broker")

    def _begin(self, length: int) -> None:
        if length > self.max_items:
            raise MalformedMessage("a message has too many items")
        if len(self._open) >= MAX_DEPTH:
            raise MalformedMessage("lists are nested too deeply")
        self._open.append((length, []))
