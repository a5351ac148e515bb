"""Assembly of frames and blobs in any order, within limits of count, bytes and age."""

from __future__ import annotations

import itertools
import json
import random
import struct
import tracemalloc

import pytest

from rce.errors import InvalidRequest, LimitExceeded, TimedOut
from rce.protocol.assembler import Assembled, Assembler, AssemblyLimits
from rce.protocol.blobs import PART, binary_frames
from rce.protocol.messages import Frame, decode_frame

IDS = [f"{number:032x}" for number in range(200)]


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def frame(*ids: str, **more: object) -> Frame:
    data = {"list": [{"x*": name} for name in ids], **more}
    return decode_frame(json.dumps({"type": "DM", "data": data}).encode())


def blob(name: str, content: bytes) -> bytes:
    return name.encode() + content


def part(name: str, offset: int, total: int, content: bytes) -> bytes:
    return name.encode() + struct.pack("!II", offset, total) + content


def content(assembled: Assembled | None) -> dict[str, bytes]:
    assert assembled is not None
    return {name: bytes(value) for name, value in assembled.blobs.items()}


def test_frame_without_references_is_complete_at_once() -> None:
    given = frame(note="*")
    complete = Assembler(Clock()).add_frame(given).complete
    assert complete is not None
    assert complete.frame is given
    assert complete.blobs == {}


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_message_is_complete_once_in_any_order(order: tuple[int, ...]) -> None:
    assembler = Assembler(Clock())
    inputs = [
        lambda: assembler.add_frame(frame(*IDS[:2])),
        lambda: assembler.add_blob(blob(IDS[0], b"zero")),
        lambda: assembler.add_blob(blob(IDS[1], b"one")),
    ]
    outcomes = [inputs[index]() for index in order]
    assert [outcome.complete is not None for outcome in outcomes] == [False, False, True]
    assert content(outcomes[-1].complete) == {IDS[0]: b"zero", IDS[1]: b"one"}
    assert assembler.add_frame(frame(IDS[0])).complete is None, "blobs of a complete message are not kept"


def test_later_blob_with_the_same_id_replaces_the_earlier_one() -> None:
    assembler = Assembler(Clock())
    assembler.add_blob(blob(IDS[0], b"old"))
    assembler.add_blob(blob(IDS[0], b"newer"))
    assert content(assembler.add_frame(frame(IDS[0])).complete) == {IDS[0]: b"newer"}


@pytest.mark.parametrize("first", ["frame", "blobs"])
def test_parts_of_several_blobs_may_be_interleaved(first: str) -> None:
    assembler = Assembler(Clock(), parts=True)
    blobs = {IDS[0]: random.randbytes(3 * PART + 5), IDS[1]: random.randbytes(PART), IDS[2]: b""}
    each = [binary_frames({name: value}, parts=True) for name, value in blobs.items()]
    turns = [piece for turn in itertools.zip_longest(*each) for piece in turn if piece is not None]
    outcomes = [assembler.add_frame(frame(*blobs))] if first == "frame" else []
    outcomes += [assembler.add_blob(piece.join()) for piece in turns]
    if first == "blobs":
        outcomes.append(assembler.add_frame(frame(*blobs)))
    assert [outcome.complete for outcome in outcomes[:-1]] == [None] * (len(outcomes) - 1)
    assert content(outcomes[-1].complete) == blobs


@pytest.mark.parametrize("size", [1, 7, 39, 40, 41, 1000])
@pytest.mark.parametrize("parts", [False, True])
def test_fragments_of_a_frame_may_be_cut_anywhere(size: int, parts: bool) -> None:
    assembler = Assembler(Clock(), parts=parts)
    value = random.randbytes(700)
    frames = (
        [part(IDS[0], 0, 700, value[:300]), part(IDS[0], 300, 700, value[300:])] if parts else [blob(IDS[0], value)]
    )
    for each in frames:
        assembler.add_blob(*(each[start : start + size] for start in range(0, len(each), size)))
    assert content(assembler.add_frame(frame(IDS[0])).complete) == {IDS[0]: value}


def test_part_out_of_order_is_refused_and_the_blob_may_be_sent_again() -> None:
    assembler = Assembler(Clock(), parts=True)
    assembler.add_frame(frame(IDS[0]))
    assembler.add_blob(part(IDS[0], 0, 6, b"ab"))
    for offset, total in ((4, 6), (0, 1), (2, 7), (5, 6)):
        with pytest.raises(InvalidRequest):
            assembler.add_blob(part(IDS[0], offset, total, b"cd"))
    with pytest.raises(InvalidRequest, match="does not follow"):
        assembler.add_blob(part(IDS[1], 2, 6, b"cd"))
    assembler.add_blob(part(IDS[0], 0, 4, b"AB"))
    assert content(assembler.add_blob(part(IDS[0], 2, 4, b"CD")).complete) == {IDS[0]: b"ABCD"}


@pytest.mark.parametrize("payload", [b"", b"short", b"g" * 32, b"a" * 31 + b"\n", b"a" * 32 + b"1234567"])
def test_malformed_binary_frame_is_refused(payload: bytes) -> None:
    with pytest.raises(InvalidRequest, match="32 hex"):
        Assembler(Clock(), parts=True).add_blob(payload)


def test_empty_part_of_a_nonempty_blob_is_refused() -> None:
    with pytest.raises(InvalidRequest):
        Assembler(Clock(), parts=True).add_blob(part(IDS[0], 0, 5, b""))


def test_two_incomplete_frames_cannot_share_an_id() -> None:
    assembler = Assembler(Clock())
    assembler.add_frame(frame(IDS[0]))
    with pytest.raises(InvalidRequest, match="use new ids"):
        assembler.add_frame(frame(IDS[1], IDS[0]))
    assert content(assembler.add_blob(blob(IDS[0], b"x")).complete) == {IDS[0]: b"x"}


def test_old_message_is_dropped_and_each_blob_renews_its_age() -> None:
    clock = Clock()
    assembler = Assembler(clock, limits=AssemblyLimits(age=60))
    first, second = frame(*IDS[:3]), frame(IDS[3])
    assembler.add_frame(first)
    assembler.add_frame(second)
    clock.now = 59
    assembler.add_blob(blob(IDS[0], b"x"))
    assert assembler.sweep() == []
    clock.now = 60
    (dropped,) = assembler.sweep()
    assert dropped.frame is second
    assert isinstance(dropped.error, TimedOut)
    clock.now = 119
    (dropped,) = assembler.sweep()
    assert dropped.frame is first
    assert assembler.add_blob(blob(IDS[3], b"late")) == (None, ()), "a blob of a dropped message is not kept"
    assert assembler.add_frame(frame(IDS[3])).complete is None


def test_too_many_blobs_drop_the_least_recently_used_message() -> None:
    assembler = Assembler(Clock(), limits=AssemblyLimits(blobs=3))
    first, second = frame(IDS[0], IDS[1]), frame(IDS[2])
    assembler.add_frame(first)
    assembler.add_frame(second)
    assembler.add_blob(blob(IDS[0], b"x"))
    (dropped,) = assembler.add_blob(blob(IDS[3], b"y")).dropped
    assert dropped.frame is second
    assert isinstance(dropped.error, LimitExceeded)
    assert content(assembler.add_blob(blob(IDS[1], b"z")).complete) == {IDS[0]: b"x", IDS[1]: b"z"}


def test_too_many_bytes_drop_the_oldest_message_and_ignore_its_later_parts() -> None:
    assembler = Assembler(Clock(), parts=True, limits=AssemblyLimits(memory=1000, message=600))
    assembler.add_blob(part(IDS[0], 0, 500, b"x" * 100))
    assert assembler.add_blob(part(IDS[1], 0, 400, b"x" * 100)).dropped == ()
    (dropped,) = assembler.add_blob(part(IDS[2], 0, 600, b"x")).dropped[:1]
    assert dropped.frame is None
    assert assembler.add_blob(part(IDS[0], 100, 500, b"x" * 400)) == (None, ())
    with pytest.raises(InvalidRequest):
        assembler.add_blob(part(IDS[0], 100, 500, b"x" * 400))


@pytest.mark.parametrize("first", ["frame", "blob"])
def test_message_over_the_size_limit_is_dropped(first: str) -> None:
    assembler = Assembler(Clock(), limits=AssemblyLimits(message=1000))
    given = frame(*IDS[:2])
    assembler.add_blob(blob(IDS[0], b"x" * 600))
    if first == "frame":
        assembler.add_frame(given)
        (dropped,) = assembler.add_blob(blob(IDS[1], b"x" * 600)).dropped
    else:
        assembler.add_blob(blob(IDS[1], b"x" * 600))
        (dropped,) = assembler.add_frame(given).dropped
    assert dropped.frame is given
    assert isinstance(dropped.error, LimitExceeded)
    (dropped,) = Assembler(Clock(), limits=AssemblyLimits(blobs=1)).add_frame(given).dropped
    assert dropped.frame is given


def test_memory_for_hostile_input_is_bounded() -> None:
    rng = random.Random(1)
    clock = Clock()
    limits = AssemblyLimits(blobs=16, memory=200_000, message=50_000)
    assembler = Assembler(clock, parts=True, limits=limits)
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(2000):
            clock.now += 0.01
            name = f"{rng.getrandbits(128):032x}"
            if rng.random() < 0.5:
                assembler.add_frame(frame(*(f"{rng.getrandbits(128):032x}" for _ in range(rng.randrange(1, 30)))))
            else:
                assembler.add_blob(part(name, 0, rng.randrange(2, 80_000), b"x"))
        assert tracemalloc.get_traced_memory()[0] - before < 2 * limits.memory
    finally:
        tracemalloc.stop()


def test_frame_with_a_million_ids_is_dropped() -> None:
    ids = ",".join(f'"{number:032x}"' for number in range(1_000_000))
    given = decode_frame(f'{{"type":"DM","data":{{"x*":[{ids}]}}}}'.encode())
    (dropped,) = Assembler(Clock()).add_frame(given).dropped
    assert isinstance(dropped.error, LimitExceeded)
