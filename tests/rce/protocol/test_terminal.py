"""Terminal streams over a lossy line: no bytes are lost, duplicated or out of order."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest

from rce.protocol import terminal as t


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.mark.parametrize("seed", range(20))
def test_all_bytes_arrive_despite_dropped_and_duplicated_frames(seed: int) -> None:
    chance, clock = random.Random(seed), Clock()
    wire: list[bytes] = []
    out, into = t.SendStream(wire.append, clock), t.ReceiveStream()
    sent = chance.randbytes(3 * t.WINDOW)
    put, got = 0, b""
    while len(got) < len(sent):
        size = min(out.room, chance.randrange(1, 50_000))
        out.write(sent[put : put + size])
        put += min(size, len(sent) - put)
        frames, wire[:] = wire[:], []
        for frame in frames * chance.choice([1, 1, 2]):
            if chance.random() < 0.8:
                assert frame[:1] == t.DATA
                got += into.receive(frame[1:])
        if chance.random() < 0.8:
            out.acknowledged(into.acknowledgement()[1:])
        clock.now += 0.5
        out.tick()
        assert clock.now < 10_000
    assert got == sent


def test_bytes_in_flight_are_limited_to_the_window() -> None:
    wire: list[bytes] = []
    out = t.SendStream(wire.append)
    out.write(b"x" * t.WINDOW)
    assert out.room == 0
    assert sum(len(frame) - 9 for frame in wire) == t.WINDOW
    out.acknowledged(t.ReceiveStream().acknowledgement()[1:])
    assert out.room == 0


def test_unacknowledged_bytes_are_sent_again_with_growing_intervals() -> None:
    clock, wire = Clock(), list[bytes]()
    out = t.SendStream(wire.append, clock)
    out.write(b"abc")
    times = []
    for _ in range(400):
        clock.now += 0.1
        before = len(wire)
        out.tick()
        times += [clock.now] if len(wire) > before else []
    gaps = [round(after - before) for before, after in pairwise(times)]
    assert gaps[:3] == [2, 4, 8]
    assert set(gaps[2:]) == {8}
    assert set(wire) == {wire[0]}


def test_frames_round_trip() -> None:
    request = t.Request(24, 80, "xterm", "echo 'ü'")
    assert t.Request.decode(request.encode()[1:]) == request
    assert t.read_size(t.size_frame(50, 132)[1:]) == (50, 132)
    assert t.read_exit(t.exit_frame(-1, 2**40)[1:]) == (-1, 2**40)
    assert t.from_cdr(t.to_cdr(b"\0bytes") + b"\0\0") == b"\0bytes"
