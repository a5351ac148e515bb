"""Tests of named arrays as one file or message."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.files import arrays
from rce.mapping.files.arrays import pack_arrays, unpack_arrays

ARRAYS = {"graph/poses": np.arange(6.0).reshape(2, 3), "about": np.array(["a", "b"])}


@pytest.mark.parametrize("compress", [True, False])
def test_arrays_survive_packing(tmp_path: Path, compress: bool) -> None:
    data = pack_arrays(ARRAYS, compress)
    path = tmp_path / "file.npz"
    path.write_bytes(data)
    for source in (io.BytesIO(data), path):
        found = unpack_arrays(source, "the file", "a map")
        assert found.keys() == ARRAYS.keys()
        assert all(np.array_equal(found[name], array) for name, array in ARRAYS.items())


@pytest.mark.parametrize("data", [b"", b"no archive", pack_arrays(ARRAYS)[:-30], pack_arrays(ARRAYS)[:40]])
def test_other_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(InvalidRequest, match="the message is not a map") as refused:
        unpack_arrays(io.BytesIO(data), "the message", "a map", field="state")
    assert refused.value.field == "state"


def test_objects_are_refused() -> None:
    whole = io.BytesIO()
    np.savez(whole, objects=np.array([{}], object))
    with pytest.raises(InvalidRequest):
        unpack_arrays(whole, "the message", "a map")


def test_bomb_is_refused_before_it_is_unpacked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrays, "MAX_BYTES", 1000)
    with pytest.raises(InvalidRequest, match="more than 1,000 bytes"):
        unpack_arrays(io.BytesIO(pack_arrays({"zeros": np.zeros(10_000)})), "the message", "a map")
