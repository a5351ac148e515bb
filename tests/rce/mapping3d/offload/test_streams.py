from __future__ import annotations

import msgspec
import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping3d.evaluation.room import QVGA
from rce.mapping3d.offload.streams import Format, FrameDecoder, FrameEncoder, FrameMessage
from tests.support.rgbd import CLEAN, simulated

FRAMES = list(simulated(0.2, faults=CLEAN))


@pytest.mark.parametrize("format", ["jpeg", "h264"])
def test_frames_arrive_with_their_depth_to_the_millimetre(format: Format) -> None:
    if format != "jpeg":
        pytest.importorskip("av", reason="needs the extra `video`")
    encoder, decoder = FrameEncoder(QVGA, format), FrameDecoder()
    for frame in FRAMES:
        found = decoder.decode(encoder.encode(frame))
        assert found is not None
        assert found[1] == QVGA
        assert found[0].stamp == frame.stamp
        assert np.abs(found[0].depth - frame.depth).max() <= 0.00051
        assert np.abs(found[0].color.astype(int) - frame.color).mean() < 12


def test_lost_frame_of_video_costs_frames_until_a_key_frame_is_asked_for() -> None:
    pytest.importorskip("av", reason="needs the extra `video`")
    encoder, decoder = FrameEncoder(QVGA, "h264"), FrameDecoder()
    first, _, third = (encoder.encode(frame) for frame in FRAMES[:3])
    assert decoder.decode(first) is not None
    assert decoder.decode(third) is None
    encoder.request_key()
    assert decoder.decode(encoder.encode(FRAMES[3])) is not None


@pytest.mark.parametrize(
    "changes",
    [{"color": b"x"}, {"depth": b""}, {"camera": (0, 240, 1.0, 1.0, 1.0, 1.0)}, {"camera": (16, 16, *4 * (1.0,))}],
)
def test_damaged_frame_is_refused(changes: dict[str, object]) -> None:
    message = msgspec.msgpack.decode(FrameEncoder(QVGA).encode(FRAMES[0]), type=FrameMessage)
    with pytest.raises(InvalidRequest, match="damaged"):
        FrameDecoder().decode(msgspec.msgpack.encode(msgspec.structs.replace(message, **changes)))


def test_other_bytes_are_refused() -> None:
    with pytest.raises(InvalidRequest, match="not a frame"):
        FrameDecoder().decode(b"\x93")
