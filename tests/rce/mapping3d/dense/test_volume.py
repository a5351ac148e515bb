from __future__ import annotations

import numpy as np
import pytest

from rce.mapping3d.dense.volume import Volume, VolumeFull, without_edges
from tests.support.rooms import CAMERA, looking, view

POSE = looking(-0.5, 0.0, 1.3, 30.0, 20.0)


def test_distances_are_those_to_the_wall() -> None:
    volume, frame = Volume(0.04, 0.12, 4000), view(looking(0.0, 0.0, 1.3, 180.0)).frame
    volume.add(frame.depth, frame.color, CAMERA, looking(0.0, 0.0, 1.3, 180.0))
    slots = np.flatnonzero(volume.live)
    centres, _ = volume.centres()
    block, index = np.nonzero(volume.voxels[slots, :, 1])
    sums = volume.voxels[slots[block], index]
    distances = sums[:, 0] / sums[:, 1] / 2000 * 0.12
    front = (np.abs(centres[:, 1]) < 0.5) & (np.abs(centres[:, 2] - 1.3) < 0.3)
    expected = np.minimum(centres[front, 0] + 2.0, 0.12)
    assert np.abs(distances[front] - expected).max() < 0.001
    assert (sums[front, 2:] / sums[front, 1:2]).astype(int).tolist()[0] == [200, 60, 60]


def test_removed_image_leaves_nothing_behind() -> None:
    volume = Volume(0.04, 0.12, 8000)
    frames = [(view(pose).frame, pose) for pose in (POSE, looking(-0.4, 0.1, 1.2, 45.0, 15.0))]
    for frame, pose in frames:
        volume.add(frame.depth, frame.color, CAMERA, pose)
    for frame, pose in frames:
        volume.remove(frame.depth, frame.color, CAMERA, pose)
    volume.collect()
    assert not volume.voxels.any()
    assert not volume.live.any()


def test_what_remains_is_as_if_the_removed_image_had_never_been_there() -> None:
    frame, other = view(POSE).frame, view(looking(-0.4, 0.1, 1.2, 45.0, 15.0)).frame
    volume, alone = Volume(0.04, 0.12, 8000), Volume(0.04, 0.12, 8000)
    volume.add(frame.depth, frame.color, CAMERA, POSE)
    volume.add(other.depth, other.color, CAMERA, looking(-0.4, 0.1, 1.2, 45.0, 15.0))
    volume.remove(other.depth, other.color, CAMERA, looking(-0.4, 0.1, 1.2, 45.0, 15.0))
    volume.collect()
    alone.add(frame.depth, frame.color, CAMERA, POSE)
    alone.collect()
    assert volume.live.sum() == alone.live.sum()
    assert (volume.voxels.sum(axis=(0, 1)) == alone.voxels.sum(axis=(0, 1))).all()


def test_freed_blocks_are_used_again() -> None:
    frame = view(POSE).frame
    volume = Volume(0.04, 0.12, 4000)
    for _ in range(3):
        volume.add(frame.depth, frame.color, CAMERA, POSE)
        used = int(volume.live.sum())
        volume.remove(frame.depth, frame.color, CAMERA, POSE)
        volume.collect()
    assert 2 * used < 3 * 4000


def test_image_that_does_not_fit_changes_nothing() -> None:
    frame = view(POSE).frame
    volume = Volume(0.04, 0.12, 10)
    with pytest.raises(VolumeFull):
        volume.add(frame.depth, frame.color, CAMERA, POSE)
    assert not volume.live.any()


def test_pixels_at_edges_and_far_away_are_left_out() -> None:
    depth = np.full((20, 20), 1.0, np.float32)
    depth[:, 10:] = 2.0
    depth[5, 3] = 0.0
    depth[15:, :] = 6.0
    kept = without_edges(depth, 5.0) > 0
    assert not kept[:, 9:11].any()
    assert not kept[14:].any()
    assert not kept[5, 3]
    assert kept[4, 3]
    assert kept[:14, :9].sum() == 14 * 9 - 1
