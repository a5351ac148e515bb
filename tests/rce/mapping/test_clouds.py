from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rce.errors import InvalidRequest
from rce.mapping.clouds import Sweep, decode
from tests.support.sweeps import message

SWEEP = Sweep(
    12.5, np.array([[1, 2, 3], [-4, 5, 6], [7, 8, -9], [0.5, 0, 0]], np.float32), np.array([0.0, 0.025, 0.05, 0.1])
)


@pytest.mark.parametrize("layout", ["f4", "f8"])
@pytest.mark.parametrize("big", [False, True])
def test_points_are_read_in_any_type_and_byte_order(layout: str, big: bool) -> None:
    sweep = decode(message(SWEEP, layout, is_bigendian=big))
    assert sweep.stamp == 12.5
    assert sweep.points.tolist() == SWEEP.points.tolist()
    assert sweep.times.tolist() == [0, 0, 0, 0]


@pytest.mark.parametrize(
    "time",
    [
        ("t", "u4", 1e-9),
        ("offset_time", "u4", 1e-9),
        ("time", "f4", 1.0),
        ("timestamp", "f8", 1.0),
        ("timestamp", "f8", 1e-3),
        ("time", "f4", 1e-6),
    ],
)
def test_times_of_drivers_become_seconds_since_the_first_point(time: tuple[str, str, float]) -> None:
    assert np.abs(decode(message(SWEEP, time=time)).times - SWEEP.times).max() < 1e-6


def test_times_since_an_epoch_count_from_the_first_point() -> None:
    later = Sweep(SWEEP.stamp, SWEEP.points, SWEEP.times + 1.7e9)
    assert np.abs(decode(message(later, time=("timestamp", "f8", 1.0))).times - SWEEP.times).max() < 1e-6


def test_points_without_a_return_are_left_out() -> None:
    points = SWEEP.points.copy()
    points[1] = np.nan
    points[2] = 0.0
    sweep = decode(message(Sweep(0.0, points, SWEEP.times), time=("t", "u4", 1e-9)))
    assert sweep.points.tolist() == [[1, 2, 3], [0.5, 0, 0]]
    assert np.abs(sweep.times - [0.0, 0.1]).max() < 1e-6


def test_rows_may_end_with_padding() -> None:
    flat = message(SWEEP)
    step, data = flat.point_step, flat.data
    rows = data[: 2 * step] + b"\xff" * 5 + data[2 * step :] + b"\xff" * 5
    padded = message(SWEEP, height=2, width=2, row_step=2 * step + 5, data=rows)
    assert decode(padded).points.tolist() == SWEEP.points.tolist()
    without_last = message(SWEEP, height=2, width=2, row_step=2 * step + 5, data=rows[:-5])
    assert decode(without_last).points.tolist() == SWEEP.points.tolist()


def test_empty_cloud_has_no_points() -> None:
    assert decode(message(SWEEP, width=0, row_step=0, data=b"")).points.shape == (0, 3)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"data": b"short"}, "does not fit its 5 bytes"),
        ({"point_step": 4}, "does not fit"),
        ({"fields": []}, "no field x, y, z"),
    ],
)
def test_cloud_that_contradicts_itself_is_refused(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(InvalidRequest, match=reason):
        decode(message(SWEEP, **changes))


def test_unknown_type_of_a_field_is_refused() -> None:
    cloud = message(SWEEP)
    cloud.fields[1].datatype = 99
    with pytest.raises(InvalidRequest, match="unknown type in field y"):
        decode(cloud)


@given(
    st.permutations(["x", "y", "z", "t", "ring", "rgb"]),
    st.lists(st.integers(0, 9), min_size=7, max_size=7),
    st.booleans(),
    st.integers(1, 3),
    st.integers(1, 5),
    st.integers(0, 7),
    st.randoms(use_true_random=False),
)
def test_any_layout_gives_the_same_points(
    names: list[str], gaps: list[int], big: bool, height: int, width: int, padding: int, random: Any
) -> None:
    kinds = {"x": "f4", "y": "f8", "z": "f4", "t": "u4", "ring": "u2", "rgb": "u4"}
    order, offset, offsets = ">" if big else "<", 0, []
    for name, gap in zip(names, gaps, strict=False):
        offsets.append(offset + gap)
        offset = offsets[-1] + np.dtype(kinds[name]).itemsize
    layout = np.dtype(
        {
            "names": names,
            "formats": [order + kinds[name] for name in names],
            "offsets": offsets,
            "itemsize": offset + gaps[-1],
        }
    )
    records = np.zeros((height, width), layout)
    for axis in "xyz":
        records[axis] = [[random.randint(1, 40) / 4 for _ in range(width)] for _ in range(height)]
    records["t"] = np.arange(height * width).reshape(height, width) * 1_000_000
    rows = [row.tobytes() + bytes(padding) for row in records]
    numbers = {"f4": 7, "f8": 8, "u2": 4, "u4": 6}
    cloud = message(
        SWEEP, is_bigendian=big, height=height, width=width, point_step=layout.itemsize, data=b"".join(rows)
    )
    cloud.row_step = width * layout.itemsize + padding
    cloud.fields = [
        SimpleNamespace(name=name, offset=at, datatype=numbers[kinds[name]], count=1)
        for name, at in zip(names, offsets, strict=True)
    ]
    sweep = decode(cloud)
    expected = np.stack([records[axis].ravel() for axis in "xyz"], axis=1)
    assert sweep.points.tolist() == expected.tolist()
    if height * width > 1:
        assert sweep.times[-1] == pytest.approx((height * width - 1) * 1e-3)


@given(st.binary(max_size=60), st.integers(0, 40), st.integers(0, 5), st.integers(0, 5), st.integers(0, 60))
def test_random_messages_are_read_or_refused(data: bytes, step: int, height: int, width: int, row: int) -> None:
    cloud = message(SWEEP, data=data, point_step=step, height=height, width=width, row_step=row)
    try:
        sweep = decode(cloud)
    except InvalidRequest:
        return
    assert len(sweep.points) == len(sweep.times) <= height * width
