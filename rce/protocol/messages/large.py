"""Large data messages, whose envelope is decoded without their content: scanning 10 MB of JSON takes 10 to 80 ms.

The content is found by its key near the beginning and by the last braces. It is replaced by a mark, and what is left is
decoded as a frame. If the mark is found where the content belongs and the content is valid JSON, which its converter
checks, the whole is the same frame: the result is never another one.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from msgspec import UNSET, Raw
from msgspec.structs import replace

from rce.errors import RceError
from rce.protocol.blobs import STAR
from rce.protocol.messages.data import DataMessage
from rce.protocol.messages.frames import Frame, decode_as, decode_frame

HEAD, TAIL = 4096, 2048  # bytes before and after the content, in which the other keys are
MARK = b"-0.0"  # JSON value in place of the content; a usual frame has it nowhere else
_msg = re.compile(rb'"msg"[ \t\n\r]*:[ \t\n\r]*(?=\{)')
_data = re.compile(rb'"data"[ \t\n\r]*:[ \t\n\r]*(?=\{)')
_reference = re.compile(rb'\*"[ \t\n\r]*:')  # end of a key whose value is the id of a blob


class LargeMessage(NamedTuple):
    """A data message, and its frame, whose data lacks the content."""

    frame: Frame
    message: DataMessage


class Content(NamedTuple):
    """Place of an object in JSON.

    Attributes:
        key: Match of its key.
        start: Its first byte.
        end: The byte after its last one.
    """

    key: re.Match[bytes]
    start: int
    end: int


def find_content(payload: bytes, key: re.Pattern[bytes], around: int) -> Content | None:
    """Find a large object in JSON by its key, without a search through the object.

    Args:
        payload: The JSON.
        key: Pattern of the key, up to the brace of the object.
        around: Number of objects around the large one, which end behind it.

    Returns:
        The place, which may be wrong if the JSON is unusual: decode the rest to check it. None if there is none.
    """
    found = key.search(payload, 0, HEAD)
    end = len(payload)
    for _ in range(around + 1):
        end = payload.rfind(b"}", max(0, len(payload) - TAIL), end)
    return None if found is None or end < found.end() else Content(found, found.end(), end + 1)


def _decode_rest(payload: bytes, content: Content) -> Frame | None:
    """Return the frame with the mark in place of the content. None for an unusual frame."""
    before, after = payload[: content.start], payload[content.end :]
    if MARK in before or MARK in after:
        return None
    try:
        return decode_frame(before + MARK + after)
    except RceError:
        return None


def split_large(payload: bytes) -> LargeMessage | None:
    """Return the data message of a text frame, whose content is not checked and has no references to blobs.

    Returns:
        None for all other frames, and for unusual ones: decode them as a whole.
    """
    found = find_content(payload, _msg, 2)  # the frame and its data are around it
    if found is None or (STAR in payload and _reference.search(payload)):
        return None
    frame = _decode_rest(payload, found)
    if frame is None or frame.type != "DM":
        return None
    try:
        message = decode_as(DataMessage, frame.data, "data")
    except RceError:
        return None
    if message.msg is UNSET or bytes(message.msg) != MARK or message.blob is not UNSET:
        return None
    content = memoryview(payload)[found.start : found.end]
    return LargeMessage(frame, replace(message, msg=Raw(content)))


def envelope_of(payload: bytes) -> Frame | None:
    """Return a text frame with the mark in place of its data, to report an error about the frame.

    Returns:
        None for an unusual frame, whose data is not found.
    """
    found = find_content(payload, _data, 1)
    frame = None if found is None else _decode_rest(payload, found)
    return frame if frame is not None and bytes(frame.data) == MARK else None
