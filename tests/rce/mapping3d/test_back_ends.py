from __future__ import annotations

import pytest

from rce.mapping3d.back_ends import back_end, dense_map
from rce.mapping3d.graph.mapper import Mapper3d
from rce.mapping3d.lidar.mapper import LidarMapper


@pytest.mark.parametrize(("sensor", "kind"), [("camera", Mapper3d), ("lidar", LidarMapper)])
def test_back_end_fits_the_sensor(sensor: str, kind: type) -> None:
    mapper = back_end(sensor)
    assert type(mapper) is kind
    mapper.close()


def test_voxels_of_lidars_are_larger() -> None:
    assert dense_map("lidar").voxel > dense_map("camera").voxel
