"""Frames of WebSockets, beside those of the library `websockets`."""

from __future__ import annotations

import pytest
from websockets.frames import Frame, Opcode

from endpoints.robot.framing import Unmasker, framed
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
