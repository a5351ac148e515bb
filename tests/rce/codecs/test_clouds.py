"""Clouds of points in a small form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rce.codecs.clouds import dtype_of, empty_head, pack, unpack
from rce.codecs.packed import CloudField, Header, PackedCloud
from rce.errors import ConversionError

KIND = np.dtype(
    {
        "names": ["x", "y", "z", "rgb", "ring", "time"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f8"],
        "offsets": [0, 4, 8, 16, 20, 24],
        "itemsize": 32,
    }
)


def points(count: int = 1000) -> NDArray[Any]:
    random, made = np.random.default_rng(1), np.zeros(count, KIND)
    for axis in "xyz":
        made[axis] = random.uniform(-20, 20, count)
    made["rgb"] = random.integers(0, 1 << 24, count).astype("<u4").view("<f4")
    made["ring"] = np.arange(count) % 64
    made["time"] = 1.7e9 + np.arange(count) * 1e-6
    return made


def there_and_back(codec: str, sent: NDArray[Any]) -> tuple[PackedCloud, int, NDArray[Any]]:
    head, data = pack(codec, empty_head(Header(), codec, sent), _rows(sent))
    return head, len(data), unpack(head, data)


def _rows(sent: NDArray[Any]) -> NDArray[Any]:
    head = empty_head(Header(), "", sent)
    return np.frombuffer(sent.tobytes(), dtype_of(head.fields, head.point_step))


def test_quantised_points_keep_order_colours_integers_and_what_is_not_finite() -> None:
    sent = points()
    sent["x"][3] = np.nan
    _, size, got = there_and_back("quantised", sent)
    assert size < sent.nbytes / 2
    assert np.isnan(got["x"][3, 0])
    assert np.nanmax(np.abs(got["x"][:, 0] - sent["x"])) <= 40 / 65534
    assert np.abs(got["time"][:, 0] - sent["time"]).max() < 1e-6
    for exact in ("rgb", "ring"):
        assert got[exact].tobytes() == np.ascontiguousarray(sent[exact]).tobytes()


def test_draco_keeps_the_points_that_are_finite() -> None:
    pytest.importorskip("DracoPy", reason="needs DracoPy: pip install '.[draco]'")
    sent = points()[["x", "y", "z", "rgb", "ring"]]
    sent["y"][3] = np.inf
    head, size, got = there_and_back("draco", sent)
    assert (head.width, head.height, head.is_dense) == (999, 1, True)
    assert size < sent.nbytes / 3
    kept = np.delete(sent, 3)
    order, before = np.argsort(got["ring"][:, 0] * 1000 + got["x"][:, 0]), np.argsort(kept["ring"] * 1000 + kept["x"])
    assert np.abs(got["z"][order, 0] - kept["z"][before]).max() < 0.01
    assert got["rgb"][order].tobytes() == np.ascontiguousarray(kept["rgb"][before]).tobytes()


def test_draco_refuses_what_it_has_no_type_for() -> None:
    pytest.importorskip("DracoPy", reason="needs DracoPy: pip install '.[draco]'")
    with pytest.raises(ConversionError, match="no type for the field time: use quantised"):
        there_and_back("draco", points())
    with pytest.raises(ConversionError, match="x, y and z as float32"):
        there_and_back("draco", points()[["rgb", "ring"]])


@pytest.mark.parametrize("codec", ["quantised", "draco"])
def test_cloud_without_points_stays_empty(codec: str) -> None:
    if codec == "draco":
        pytest.importorskip("DracoPy", reason="needs DracoPy: pip install '.[draco]'")
    assert len(there_and_back(codec, points(0)[["x", "y", "z"]])[2]) == 0


def test_damaged_packets_are_refused() -> None:
    sent = points(10)
    head, data = pack("quantised", empty_head(Header(), "quantised", sent), _rows(sent))
    for damaged in (b"", b"x" + data, data[:-9]):
        with pytest.raises(ConversionError, match="damaged"):
            unpack(head, damaged)
    with pytest.raises(ConversionError, match="more than"):
        unpack(PackedCloud(codec="quantised", width=1 << 31, point_step=16), data)
    with pytest.raises(ConversionError, match="no layout"):
        dtype_of([CloudField("x", 30)], 8)
