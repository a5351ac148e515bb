"""Messages between a job and its workers, as MessagePack. Arrays travel as the bytes of a `State`, see `states`."""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import Struct

from rce.errors import ErrorInfo, InvalidRequest
from rce.mapping.mapper import MapperSettings
from rce.mapping.parallel.scan_arrays import ScanArrays

MAX_SCANS = 4000  # of one unit: messages stay below the largest that the platform carries


class MapPart(Struct, frozen=True, tag="map_part"):
    """Map scans by the mapper `graph`. The result is Mapped; the worker keeps the part."""

    part: int
    scans: ScanArrays
    settings: MapperSettings


class FindOverlaps(Struct, frozen=True, tag="find_overlaps"):
    """Search places of one part in another one, see `find_overlaps`. The result is Mapped, with the overlaps."""

    own: int
    other: int


class ComparePlaces(Struct, frozen=True, tag="compare_places"):
    """Search places that are the same as nodes of a common graph, see `Team.comparison`. The result is Mapped.

    Attributes:
        parts: Parts of the team in its order.
        snapshot: Packed `Team.snapshot`.
        nodes: Numbers of the nodes.
    """

    parts: list[int]
    snapshot: bytes
    nodes: list[int]


class MapSeed(Struct, frozen=True, tag="map_seed"):
    """Map scans by the mapper `particle` with the seed of the settings. The result is Mapped, with the map."""

    scans: ScanArrays
    settings: MapperSettings


class KeepPart(Struct, frozen=True, tag="keep_part"):
    """Keep a part that another worker has mapped. The result is Mapped, without arrays."""

    part: int
    state: bytes


Work = MapPart | FindOverlaps | ComparePlaces | MapSeed | KeepPart


class Unit(Struct, frozen=True):
    """Unit of work, numbered by the job."""

    number: int
    work: Work


class Mapped(Struct, frozen=True, tag="mapped"):
    """The work is done.

    Attributes:
        state: Packed state with the result.
        seconds: Elapsed seconds.
    """

    state: bytes
    seconds: float


class Failed(Struct, frozen=True, tag="failed"):
    """The work cannot be done."""

    error: ErrorInfo


class Busy(Struct, frozen=True, tag="busy"):
    """The worker is at work; `scans` of the unit are mapped so far."""

    scans: int


class Answer(Struct, frozen=True):
    """Message of a worker about a unit."""

    number: int
    result: Mapped | Failed | Busy


_units, _answers = msgspec.msgpack.Decoder(Unit), msgspec.msgpack.Decoder(Answer)


def encode(message: Unit | Answer) -> bytes:
    """Return a message as bytes."""
    return msgspec.msgpack.encode(message)


def decode_unit(data: bytes) -> Unit:
    """Return a unit from bytes.

    Raises:
        InvalidRequest: They are no unit.
    """
    unit: Unit = _decode(_units, data, "unit of work")
    return unit


def decode_answer(data: bytes) -> Answer:
    """Return an answer from bytes.

    Raises:
        InvalidRequest: They are no answer.
    """
    answer: Answer = _decode(_answers, data, "answer of a mapping worker")
    return answer


def _decode(decoder: msgspec.msgpack.Decoder[Any], data: bytes, what: str) -> Any:
    try:
        return decoder.decode(data)
    except msgspec.MsgspecError as error:
        raise InvalidRequest(f"not a {what}: {error}") from None
