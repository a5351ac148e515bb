"""Saved state: trees of arrays, and the validation of what is read back."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from rce.errors import InvalidRequest
from rce.mapping.geometry import Pose
from rce.mapping.state import Array, Reader, State, flatten, optional, pack


def reader(**state: Array | State) -> Reader:
    return Reader(dict(flatten(state)))


def test_tree_is_flattened_to_paths_and_read_by_parts() -> None:
    state: State = {"a": np.zeros(1), "b": {"c": np.ones(2), "d": {"e": np.zeros(0)}}}
    arrays = dict(flatten(state))
    assert list(arrays) == ["a", "b/c", "b/d/e"]
    whole = Reader(arrays)
    assert whole.part("b").array("c", np.float64, 2).tolist() == [1.0, 1.0]
    assert (whole.has("b"), whole.part("b").has("d"), whole.has("a"), whole.has("x")) == (True, True, False, False)


@pytest.mark.parametrize("pose", [None, Pose(1.0, 2.0, 3.0)])
def test_optional_pose_is_read_back(pose: Pose | None) -> None:
    assert reader(pose=optional(pose)).optional("pose") == pose


@pytest.mark.parametrize("lengths", [[], [0], [2, 0, 3]])
def test_packed_arrays_are_unpacked(lengths: list[int]) -> None:
    pieces = [np.full((length, 2), float(i), np.float32) for i, length in enumerate(lengths)]
    found = reader(points=pack(pieces, np.float32)).unpack("points", np.float32)
    assert [piece.tolist() for piece in found] == [piece.tolist() for piece in pieces]
    assert all(piece.dtype == np.float32 and piece.flags.c_contiguous for piece in found)


@pytest.mark.parametrize("lengths", [[1, 1], [3, 1], [4], [-1, 4]])
def test_lengths_must_add_up(lengths: list[int]) -> None:
    saved = reader(points={"rows": np.zeros((3, 2)), "lengths": np.array(lengths)})
    with pytest.raises(InvalidRequest, match="points/lengths"):
        saved.unpack("points", np.float64)


@pytest.mark.parametrize(
    ("array", "reason"),
    [
        (None, "is missing"),
        (np.zeros((2, 3), np.float32), "is float32"),
        (np.zeros(6), "not float64 with 2 dimensions"),
        (np.zeros((2, 4)), "has the shape"),
        (np.full((2, 3), np.nan), "not finite"),
        (np.full((2, 3), np.inf), "not finite"),
    ],
)
def test_array_of_another_kind_is_refused(array: NDArray[np.float64] | None, reason: str) -> None:
    saved = reader(part={} if array is None else {"a": array}).part("part")
    with pytest.raises(InvalidRequest, match=f"part/a {reason}|part/a .*{reason}") as refused:
        saved.array("a", np.float64, None, 3)
    assert refused.value.field == "file"


def test_array_is_returned_contiguous() -> None:
    """Kernels refuse others."""
    array = reader(a=np.asfortranarray(np.arange(6.0).reshape(2, 3))).array("a", np.float64, None, 3)
    assert array.flags.c_contiguous
    assert array.tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]


@pytest.mark.parametrize(("values", "good"), [([0, 4], True), ([], True), ([0, 5], False), ([-1], False)])
def test_indices_are_in_range(values: list[int], good: bool) -> None:
    saved = reader(a=np.array(values, np.int64))
    if good:
        assert saved.indices("a", 5, None).tolist() == values
    else:
        with pytest.raises(InvalidRequest, match="outside of 0 to 4"):
            saved.indices("a", 5, None)


def test_single_numbers_are_read() -> None:
    saved = reader(a=np.array(2.5), b=np.array(-1, np.int64))
    assert saved.number("a") == 2.5
    assert saved.whole("b", 3, lowest=-1) == -1
    with pytest.raises(InvalidRequest, match="outside of 0 to 2"):
        saved.whole("b", 3)
