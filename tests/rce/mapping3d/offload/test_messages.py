from __future__ import annotations

import msgspec
import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import KeyFrame, RgbdFrame
from rce.mapping3d.odometry.tracker import Tracked
from rce.mapping3d.offload.messages import (
    decode,
    encode,
    information_of,
    message_of,
    pose_of,
    rebased,
    unlinked,
    unpacked,
)
from tests.support.key_frames import BLANK, key_frame, right


def test_key_frame_arrives_as_it_was_sent() -> None:
    message = decode(encode(key_frame(3, 0.2)))
    assert message == key_frame(3, 0.2)
    tracked, packed = unpacked(message, 5)
    assert tracked.key is not None
    assert (tracked.key.robot, tracked.key.index, tracked.reference, tracked.linked) == (5, 3, 2, True)
    np.testing.assert_array_equal(tracked.pose, right(0.2))
    np.testing.assert_array_equal(tracked.information, 1e4 * np.eye(6))
    assert tracked.key.frame.depth.max() == pytest.approx(2.0)
    assert packed.color == message.color


def test_numbers_of_numpy_are_sent_as_plain_ones() -> None:
    frame = RgbdFrame(float(np.float64(0.5)), BLANK.color, BLANK.depth)
    camera = Camera(320, 240, np.float64(262.5), np.float64(262.5), np.float64(159.5), np.float64(119.5))
    tracked = Tracked(0.5, -1, np.eye(4), np.eye(6), key=KeyFrame(0, 0, frame, camera), linked=False)
    assert decode(encode(message_of("run", tracked))).camera == (320, 240, 262.5, 262.5, 159.5, 119.5)


@pytest.mark.parametrize(
    "changes",
    [
        {"pose": b"short"},
        {"information": b""},
        {"camera": (0, 240, 1.0, 1.0, 1.0, 1.0)},
        {"camera": (320, 240, -1.0, 1.0, 1.0, 1.0)},
        {"stamp": float("nan")},
        {"pose": np.full(16, np.inf).tobytes()},
    ],
)
def test_damaged_key_frame_is_refused(changes: dict[str, object]) -> None:
    with pytest.raises(InvalidRequest, match="damaged"):
        decode(encode(msgspec.structs.replace(key_frame(1), **changes)))


def test_other_bytes_are_refused() -> None:
    with pytest.raises(InvalidRequest, match="not a key frame"):
        decode(b"\x01\x02")


def test_damaged_image_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="damaged"):
        unpacked(msgspec.structs.replace(key_frame(1), depth=b"no image"), 0)


def test_rebased_key_frame_refers_to_the_one_before_that_is_left_out() -> None:
    message = rebased(key_frame(4, 0.2), key_frame(3, 0.1), np.eye(6))
    assert message.reference == 2
    np.testing.assert_allclose(pose_of(message), right(0.3))
    np.testing.assert_array_equal(information_of(message), np.eye(6))


def test_unlinked_key_frame_has_a_guess() -> None:
    assert not unlinked(key_frame(4)).linked
