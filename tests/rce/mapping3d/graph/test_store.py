from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping3d.evaluation.room import QVGA
from rce.mapping3d.frames import KeyFrame
from rce.mapping3d.graph.store import KeyFrameStore, pack, unpack
from tests.support.rgbd import simulated

KEYS = [KeyFrame(1, number, frame, QVGA) for number, frame in enumerate(simulated(0.1))]


def test_key_frames_come_back_with_exact_depths_and_nearly_the_same_colours() -> None:
    store = KeyFrameStore()
    numbers = [store.add(pack(key)) for key in KEYS]
    for number, key in zip(numbers, KEYS, strict=True):
        again = store.key_frame(number)
        assert (again.robot, again.index, again.camera, again.frame.stamp) == (1, key.index, QVGA, key.frame.stamp)
        np.testing.assert_allclose(again.frame.depth, key.frame.depth, atol=1.3e-4)
        assert np.abs(again.frame.color.astype(int) - key.frame.color).mean() < 8
    assert len(store) == len(KEYS)
    store.close()


def test_damaged_key_frame_is_refused() -> None:
    packed = pack(KEYS[0])
    with pytest.raises(InvalidRequest, match="key frame 0 of robot 1 is damaged"):
        unpack(replace(packed, depth=packed.color))
    with pytest.raises(InvalidRequest, match="damaged"):
        unpack(replace(packed, depth=b""))
