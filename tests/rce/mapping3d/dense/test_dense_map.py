from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.files.maps import read_map
from rce.mapping3d.camera import Camera
from rce.mapping3d.dense.dense_map import DENSE_CONFIG, DenseMap
from rce.mapping3d.frames import KeyFrame, RgbdFrame
from rce.mapping3d.poses import Pose, make_pose
from tests.support.paths import DATA
from tests.support.rooms import ROOM, TABLE, looking, round_trip, view

COARSE = dataclasses.replace(DENSE_CONFIG, voxel=0.04, max_blocks=8_000)
SEQUENCE = DATA / "rgbd-7scenes"


def mapped(turn: Pose = np.eye(4)) -> DenseMap:  # noqa: B008  # never changed
    dense = DenseMap(COARSE)
    for key_frame, pose in round_trip():
        dense.add(key_frame, turn @ pose)
    return dense


def test_surface_is_on_the_walls_and_the_table() -> None:
    points = mapped().cloud().points
    walls = np.abs(np.maximum(ROOM[0] - points, points - ROOM[1]).max(axis=1))
    table = np.abs(np.maximum(TABLE[0] - points, points - TABLE[1]).max(axis=1))
    assert np.quantile(np.minimum(walls, table), 0.99) < 0.01


def test_moved_key_frames_give_the_map_of_their_new_poses() -> None:
    offset = make_pose(np.eye(3), [0.3, -0.2, 0.1])
    dense, expected = mapped(), mapped(offset)
    for key_frame, pose in round_trip():
        dense.move(key_frame.robot, key_frame.index, offset @ pose)
    assert sorted(dense.cloud().points.tolist()) == sorted(expected.cloud().points.tolist())


def test_small_moves_change_nothing() -> None:
    dense = mapped()
    before = dense.mesh()
    dense.move(0, 3, make_pose(np.eye(3), [0.001, 0, 0]) @ round_trip()[3][1])
    assert dense.mesh() is before


def test_removed_key_frames_leave_an_empty_map() -> None:
    dense = mapped()
    for key_frame, _ in round_trip():
        dense.remove(0, key_frame.index)
    assert not len(dense.cloud().points)
    dense.move(0, 0, np.eye(4))  # is ignored


def test_second_key_frame_of_the_same_name_is_refused() -> None:
    dense = mapped()
    with pytest.raises(InvalidRequest, match="key frame 2 of robot 0 is in the map already"):
        dense.add(*round_trip()[2])


def test_full_map_goes_on_with_larger_voxels() -> None:
    dense = DenseMap(dataclasses.replace(COARSE, max_blocks=300))
    for key_frame, pose in round_trip():
        dense.add(key_frame, pose)
    assert dense.voxel == 0.08
    points = dense.cloud().points
    assert points[:, 0].min() < -1.9
    assert points[:, 0].max() > 1.9


def test_at_the_bound_the_key_frame_closest_to_another_leaves_the_map() -> None:
    dense = DenseMap(dataclasses.replace(COARSE, max_frames=3))
    poses = [looking(-1, 0, 1.3, 0), looking(-1, 0, 1.3, 90), looking(-1, 0, 1.3, 92), looking(-1, 0, 1.3, 180)]
    for index, pose in enumerate(poses):
        dense.add(view(pose, index=index), pose)
    dense.add(view(poses[2], index=2), poses[2])  # it had left, so it is accepted again


def test_goal_in_a_room_with_an_unseen_side_looks_there() -> None:
    dense = DenseMap(COARSE)
    poses = [looking(-1.5, y, 1.0, 180.0 + turn, 35.0) for turn, y in ((-90, 0.0), (-45, 0.0), (0, 0.0), (45, 0.0))]
    for index, pose in enumerate([looking(-0.5, 0, 1.0, 180, 30), *poses]):
        dense.add(view(pose, index=index), pose)
    goal = dense.next_goal(looking(-1.2, 0.0, 1.0, 180.0))
    assert goal is not None
    assert abs(goal[2, 3] - 1.0) < 0.01
    assert abs(goal[2, 2]) < 0.01
    assert (np.abs(goal[:2, 3]) < ROOM[1, :2]).all()


def test_empty_map_has_no_goal_and_a_plan_of_one_cell() -> None:
    dense = DenseMap(COARSE)
    assert dense.next_goal(np.eye(4)) is None
    assert dense.grid().cells.shape == (1, 1)


def test_written_files_are_readable(tmp_path: Path) -> None:
    dense = mapped()
    written = dense.write(tmp_path / "out", {0: [pose for _, pose in round_trip()]})
    assert sorted(path.name for path in written) == [
        *("cloud.ply", "map.bt", "map.pgm", "map.yaml", "mesh.ply", "view.png")
    ]
    assert (read_map(tmp_path / "out" / "map.yaml").cells == 100).sum() == (dense.grid().cells == 100).sum()


def recorded(number: int) -> tuple[KeyFrame, Pose]:
    name = SEQUENCE / f"frame-{number:06d}"
    color = cv2.imread(f"{name}.color.jpg")
    raw = cv2.imread(f"{name}.depth.png", cv2.IMREAD_UNCHANGED)
    assert color is not None
    assert raw is not None
    depth = np.where(raw == 65535, 0, raw).astype(np.float32) / 1000
    frame = RgbdFrame(number / 30, np.ascontiguousarray(color[:, :, ::-1]), depth)
    return KeyFrame(0, number, frame, Camera(640, 480, 585.0, 585.0, 320.0, 240.0)), np.loadtxt(f"{name}.pose.txt")


@pytest.mark.slow
@pytest.mark.skipif(not SEQUENCE.is_dir(), reason=f"no recordings in {SEQUENCE}")
def test_table_of_a_real_recording_is_flat_and_level() -> None:
    dense = DenseMap(DENSE_CONFIG)
    for number in range(0, 400, 20):
        dense.add(*recorded(number))
    level, cloud = dense.level(), dense.cloud()
    heights = cloud.points.astype(np.float64) @ level[2, :3] + level[2, 3]
    upward = cloud.normals @ level[2, :3] > 0.95
    table = heights[upward & (heights > 0.6) & (heights < 0.85)]
    assert len(table) > 3000
    top = np.median(table)
    assert np.quantile(np.abs(table - top), 0.8) < 0.015  # one table, not two
