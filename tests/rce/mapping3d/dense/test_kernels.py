from __future__ import annotations

import numpy as np

from rce.mapping3d.dense import kernels


def test_each_block_is_found_in_its_slot() -> None:
    generator = np.random.default_rng(1)
    blocks = np.unique(generator.integers(-500, 500, (400, 3)), axis=0).astype(np.int32)
    live = np.ones(len(blocks), np.bool_)
    live[7] = False
    keys, slots = np.full(1024, kernels.EMPTY, np.int64), np.zeros(1024, np.int32)
    kernels.fill_table(keys, slots, blocks, live)
    found = np.empty(len(blocks), np.int64)
    kernels.look_up(keys, slots, kernels.keys_of(blocks.astype(np.int64)), found)
    expected = np.where(live, np.arange(len(blocks)), -1)
    assert found.tolist() == expected.tolist()


def test_keys_of_arrays_and_of_one_block_agree() -> None:
    assert kernels.keys_of(np.array([[3, -4, 5]]))[0] == kernels.key_of(3, -4, 5)


def test_blocks_in_view_that_do_not_fit_are_refused() -> None:
    depth = np.full((20, 20), 2.0, np.float32)
    found = np.full(4, kernels.EMPTY, np.int64)
    assert kernels.find_blocks(depth, np.eye(4), np.array([10.0, 10.0, 9.5, 9.5]), 0.16, 0.06, found) == -1
