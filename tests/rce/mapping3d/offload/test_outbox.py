from __future__ import annotations

import numpy as np

from rce.mapping3d.offload.messages import pose_of
from rce.mapping3d.offload.outbox import Outbox, joined
from rce.mapping3d.poses import make_pose
from tests.support.key_frames import key_frame, right

ONE = len(key_frame(0).color) + len(key_frame(0).depth)


def test_key_frames_leave_in_order_and_stay_until_they_are_acknowledged() -> None:
    outbox = Outbox(100 * ONE)
    for index in range(3):
        outbox.add(key_frame(index))
    assert [getattr(outbox.after(index), "index", None) for index in (-1, 0, 1, 2)] == [0, 1, 2, None]
    outbox.acknowledge(0)
    outbox.acknowledge(0)
    assert len(outbox) == 2
    assert outbox.size == 2 * ONE


def test_memory_is_bounded_and_the_way_stays_connected() -> None:
    outbox = Outbox(5 * ONE)
    ways = [0.1, 0.1, 0.01, 0.2, 0.1, 0.1, 0.1, 0.3]
    for index, way in enumerate(ways):
        outbox.add(key_frame(index, way))
    assert outbox.size <= 5 * ONE
    assert outbox.left_out == 3
    kept, index, total = [], -1, np.eye(4)
    while (message := outbox.after(index)) is not None:
        assert message.reference == (kept[-1] if kept else -1), "each refers to the one before"
        kept.append(message.index)
        total = total @ pose_of(message)
        index = message.index
    assert kept[-1] == 7
    assert 1 not in kept, "the one with the least motion before and after it"
    np.testing.assert_allclose(total, right(sum(ways)), atol=1e-9)


def test_oldest_is_left_out_where_no_motions_can_be_joined() -> None:
    outbox = Outbox(2 * ONE)
    for index in range(4):
        outbox.add(key_frame(index, linked=False))
    assert [getattr(outbox.after(index), "index", None) for index in (-1, 2)] == [2, 3]


def test_two_motions_are_less_certain_than_one() -> None:
    first, second = np.diag([4.0, 4.0, 4.0, 100.0, 100.0, 100.0]), np.diag([4.0] * 3 + [50.0] * 3)
    together = joined(first, second, make_pose(np.eye(3), (0.0, 0.0, 0.0)))
    np.testing.assert_allclose(together.diagonal()[:3], 2.0, rtol=1e-2)
    far = joined(first, second, right(2.0))
    assert far[1, 1] < together[1, 1], "a turn before a way moves its end"
