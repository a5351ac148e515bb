"""Tests of the messages between a job and its workers."""

from __future__ import annotations

import pytest

from rce.errors import InvalidRequest
from rce.mapping.mapper import MapperSettings
from rce.mapping.parallel.scan_arrays import pack_scans
from rce.mapping.parallel.units import (
    Answer,
    Busy,
    ComparePlaces,
    Failed,
    FindOverlaps,
    KeepPart,
    MapPart,
    Mapped,
    MapSeed,
    Unit,
    Work,
    decode_answer,
    decode_unit,
    encode,
)

SCANS = pack_scans([])


@pytest.mark.parametrize(
    "work",
    [
        MapPart(3, SCANS, MapperSettings(resolution=0.1)),
        MapSeed(SCANS, MapperSettings(seed=7)),
        FindOverlaps(1, 2),
        ComparePlaces([1, 2], b"state", [0, 5]),
        KeepPart(4, b"state"),
    ],
)
def test_units_survive_encoding(work: Work) -> None:
    assert decode_unit(encode(Unit(9, work))) == Unit(9, work)


@pytest.mark.parametrize("result", [Mapped(b"state", 0.5), Failed(InvalidRequest("no").info), Busy(17)])
def test_answers_survive_encoding(result: Mapped | Failed | Busy) -> None:
    assert decode_answer(encode(Answer(9, result))) == Answer(9, result)


@pytest.mark.parametrize("data", [b"", b"\xc1", encode(Answer(1, Busy(2))), b"\x80"])
def test_other_bytes_are_no_unit(data: bytes) -> None:
    with pytest.raises(InvalidRequest, match="not a unit of work"):
        decode_unit(data)


def test_other_bytes_are_no_answer() -> None:
    with pytest.raises(InvalidRequest, match="answer of a mapping worker"):
        decode_answer(encode(Unit(1, FindOverlaps(0, 1))))
