"""Messages between the service and its workers."""

from __future__ import annotations

from rce.knowledge.messages import HEADER, Drop, Readings, command, pack, reply


def test_message_comes_back_as_it_was() -> None:
    for message, read in ((Drop("a"), command), (Readings([]), reply)):
        packed = pack(message)
        assert HEADER.unpack(packed[: HEADER.size])[0] == len(packed) - HEADER.size
        assert read(packed[HEADER.size :]) == message
