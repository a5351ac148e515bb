"""Frames of WebSockets, beside those of the library `websockets`."""

from __future__ import annotations

import pytest
from websockets.frames import Frame, Opcode

from endpoints.robot.framing import Received, Unmasker, first_message, framed
from rce.protocol.blobs import BinaryFrame, TextFrame

MASK = bytes([1, 2, 3, 4])


@pytest.mark.parametrize("size", [0, 125, 126, 65_535, 65_536])
def test_buffer_is_a_final_text_frame(size: int) -> None:
    data = b"x" * size
    assert b"".join(framed(data)) == Frame(Opcode.TEXT, data).serialize(mask=False)


def test_head_and_data_are_one_frame_whose_data_is_not_copied() -> None:
    data = memoryview(b"y" * 200)
    for frame, opcode in ((BinaryFrame(b"head", data), Opcode.BINARY), (TextFrame(b"head", data), Opcode.TEXT)):
        parts = framed(frame)
        assert b"".join(parts) == Frame(opcode, b"head" + data).serialize(mask=False)
        assert parts[1] is data


@pytest.mark.parametrize("cut", range(6))
def test_frame_is_unmasked_in_pieces(cut: int) -> None:
    plain = b"ten bytes!"
    masked = bytes(byte ^ MASK[place % 4] for place, byte in enumerate(plain))
    unmasker = Unmasker(memoryview(MASK), len(masked))
    assert unmasker.process(masked[:cut]) + unmasker.process(memoryview(masked)[cut:]) == plain
    assert unmasker.pointer() == len(plain)


LIMIT = 65_535


@pytest.mark.parametrize("opcode", [Opcode.TEXT, Opcode.BINARY])
@pytest.mark.parametrize("size", [0, 1, 125, 126, 65_535])
def test_small_message_is_taken_from_the_beginning_of_the_data(size: int, opcode: Opcode) -> None:
    payload = bytes(index % 251 for index in range(size))
    frame = Frame(opcode, payload).serialize(mask=True)
    found = Received(payload, opcode is Opcode.BINARY, len(frame))
    assert first_message(memoryview(frame), LIMIT) == found
    assert first_message(memoryview(frame + frame), LIMIT) == found


@pytest.mark.parametrize("size", [0, 5, 200])
def test_incomplete_message_is_not_taken(size: int) -> None:
    frame = Frame(Opcode.TEXT, b"x" * size).serialize(mask=True)
    for end in range(len(frame)):
        assert first_message(memoryview(frame)[:end], LIMIT) is None


@pytest.mark.parametrize(
    "frame",
    [
        Frame(Opcode.TEXT, b"x" * 65_536).serialize(mask=True),
        Frame(Opcode.TEXT, b"unmasked").serialize(mask=False),
        Frame(Opcode.TEXT, b"x" * 200).serialize(mask=False),
        Frame(Opcode.TEXT, b"begin", fin=False).serialize(mask=True),
        Frame(Opcode.CONT, b"end").serialize(mask=True),
        b"\xc1\x80" + MASK,
        *(Frame(opcode, b"").serialize(mask=True) for opcode in (Opcode.PING, Opcode.PONG, Opcode.CLOSE)),
        b"\x83\x80" + MASK,
        b"\x81\xfe\x00\x7d" + MASK + b"x" * 125,
        b"\x81\xff\x00\x00\x00\x00\x00\x00\x00\x01" + MASK + b"x",
    ],
    ids=[
        "large",
        "unmasked",
        "unmasked-long",
        "begin",
        "end",
        "compressed",
        "ping",
        "pong",
        "close",
        "reserved",
        "not-minimal",
        "not-minimal-8",
    ],
)
def test_other_frames_are_left_to_autobahn(frame: bytes) -> None:
    assert first_message(memoryview(frame + b"more"), LIMIT) is None


def test_message_above_the_limit_is_left_to_autobahn() -> None:
    frame = memoryview(Frame(Opcode.TEXT, b"x" * 1001).serialize(mask=True))
    assert first_message(frame, 1000) is None
    assert first_message(frame, 1001) is not None
