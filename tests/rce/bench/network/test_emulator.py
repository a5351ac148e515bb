"""Emulator: packets between two devices, for which sockets stand in."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterator
from random import Random

import pytest

from rce.bench.network.emulator import Emulator
from rce.bench.network.line import Line, Way

Devices = tuple[socket.socket, socket.socket]


@pytest.fixture
def devices() -> Iterator[tuple[Devices, Devices]]:
    """Two devices: of each the end of the emulator and the end of the network."""
    pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(2)]
    for pair in pairs:
        for end in pair:
            end.setblocking(False)
    yield pairs[0], pairs[1]
    for pair in pairs:
        for end in pair:
            end.close()


async def test_packets_pass_in_order_unless_the_line_is_interrupted(devices: tuple[Devices, Devices]) -> None:
    (near, host), (far, robot) = devices
    loop = asyncio.get_running_loop()
    emulator = Emulator(loop)
    emulator.join(near.fileno(), far.fileno(), Line(Way(0.001, 0.0, 0.0, 1e9), Random(1)))
    try:
        for number in range(5):
            host.send(bytes([number]))
        assert [await loop.sock_recv(robot, 10) for _ in range(5)] == [bytes([number]) for number in range(5)]
        emulator.set_up(False)
        host.send(b"lost")
        while True:  # until the emulator has read it
            await asyncio.sleep(0)
            try:
                near.recv(10, socket.MSG_PEEK)
            except BlockingIOError:
                break
        emulator.set_up(True)
        host.send(b"next")
        assert await loop.sock_recv(robot, 10) == b"next"
    finally:
        loop.remove_reader(near.fileno())
