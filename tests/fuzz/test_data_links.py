"""Data links of a Robot endpoint: what another endpoint sends after the greeting, and greetings of strangers."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator

import pytest
from twisted.internet.base import ReactorBase

from endpoints.data.frames import HEAD, Message, pieces
from endpoints.data.port import MAGIC
from endpoints.robot.frame_receiver import ServerLimits
from rce.control.calls.endpoints import LinkSpec, Route
from tests.support.endpoints.platforms import Platform, pair
from tests.support.endpoints.raw_robot import Robot
from tests.support.fuzz.mutation import Mutator
from tests.support.fuzz.sockets import STRANGER, RawConnection

pytestmark = pytest.mark.slow

BATCH = 20  # messages of one link, of which the last may break it
TEXT = b"\0\1\0\0\6\0\0\0hello\0"  # a std_msgs/String in CDR
LARGE = 300_000  # bytes of a message that is sent in parts


@pytest.fixture
async def platform(reactor: ReactorBase) -> AsyncIterator[Platform]:
    made = Platform(reactor, ServerLimits(), grace=10.0, timeout=30.0)
    await made.start()
    yield made
    await made.endpoint.switchboard._port.close()
    await made.stop()
    await asyncio.sleep(0)


@pytest.mark.share(0.05)
async def test_frames_of_a_link_reach_their_receiver_or_end_only_the_link(
    platform: Platform, cases: int, seed: str
) -> None:
    left, right = await pair(platform)
    port = await platform.endpoint.switchboard._port.listen_tcp("127.0.0.1", 0)
    interfaces = platform.endpoint.switchboard.interfaces
    source, receiver = b"s" * 16, next(key for key, each in interfaces.items() if each.spec.tag == "in")
    left_over = cases
    for number in itertools.count():
        if left_over <= 0:
            break
        mutator = Mutator(f"{seed} link {number}")
        link = LinkSpec(f"fuzz{number}", mutator.random.randbytes(16).hex())
        platform.endpoint.switchboard.open_link(link)
        connection = await RawConnection.open(port)
        await connection.send(MAGIC + bytes.fromhex(link.key))
        assert await connection.until(MAGIC)
        await platform.endpoint.switchboard.add_route(Route(receiver.hex(), source.hex(), link.name))
        for piece in mutator.pieces(b"".join(_case(mutator, source, receiver) for _ in range(BATCH)), 20):
            await connection.send(piece)
        await connection.until_closed()
        platform.endpoint.switchboard.close_link(link.name)
        left_over -= BATCH
        await _check(left, right, number)


def _case(mutator: Mutator, source: bytes, receiver: bytes) -> bytes:
    """Return the frames of one message, in one case of five damaged."""
    payload = mutator.choose((TEXT, TEXT, b"", mutator.noise(300), bytes(LARGE) if mutator.chance(0.02) else TEXT))
    message = Message(
        source if mutator.chance(0.9) else mutator.random.randbytes(16),
        mutator.choose(("nil", "", "id", "é" * 100)),
        mutator.damage(payload) if mutator.chance(0.5) else payload,
        mutator.choose((None, receiver, bytes(16))),
        mutator.chance(0.1),
    )
    frames = [b"".join(frame) for frame in pieces(message, mutator.choose((0, 1, 2**32 - 1)))]
    if mutator.chance(0.2):
        head = HEAD.size + 33
        frames[0] = mutator.damage(frames[0][:head], 2) + frames[0][head:]
    if len(frames) > 1 and mutator.chance(0.3):
        mutator.random.shuffle(frames)
    return b"".join(frames)


async def _check(left: Robot, right: Robot, number: int) -> None:
    """Send a message between two robots of the endpoint; others may come before it."""
    await left.data("out", {"data": f"number {number}"})
    await right.until(lambda frame: frame["type"] == "DM" and frame["data"]["msg"] == {"data": f"number {number}"})


@pytest.mark.share(0.02)
async def test_strangers_open_no_link(platform: Platform, cases: int, seed: str) -> None:
    mutator = Mutator(f"{seed} greeting")
    port = await platform.endpoint.switchboard._port.listen_tcp("127.0.0.1", 0)
    for _ in range(cases):
        connection = await RawConnection.open(port, STRANGER)
        for piece in mutator.pieces(mutator.damage(MAGIC + bytes(16)) + mutator.noise(40), 3):
            await connection.send(piece)
        assert await connection.until_closed() == b""
    assert not platform.endpoint.switchboard.links
