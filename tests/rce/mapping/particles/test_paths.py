from __future__ import annotations

import numpy as np

from rce.mapping.particles.paths import Paths


def test_common_part_of_paths_is_stored_once() -> None:
    paths = Paths(3)
    for i in range(4):
        paths.append(np.full((3, 3), 10.0 * i) + np.arange(3)[:, None])
    paths.resample(np.array([0, 0, 1]))
    assert paths.branches.shape == (3, 4, 3)
    paths.append(np.arange(9.0).reshape(3, 3))
    paths.resample(np.array([1, 1, 1]))
    assert (len(paths.stem), paths.branches.shape[1], len(paths)) == (5, 0, 5)
    np.testing.assert_array_equal(paths.path(2)[:, 0], [0.0, 10.0, 20.0, 30.0, 3.0])
