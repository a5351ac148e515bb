"""A robot's WebSocket: frames of every kind, mutated, in pieces, binary and compressed."""

from __future__ import annotations

import itertools

import pytest

from tests.support.fuzz.mutation import Mutator
from tests.support.fuzz.robot_frames import FrameGrammar, frame
from tests.support.fuzz.sockets import join_robot
from tests.support.fuzz.target import Target

pytestmark = pytest.mark.slow

FEATURES = "ack,events,resume,parts"
BATCH = 25  # messages, after which the socket must answer
BATCHES = 12  # of one socket
MAX_RECEIVED = 1 << 20  # bytes that are kept


@pytest.mark.share(0.42)
async def test_each_message_is_answered_or_ends_only_its_own_socket(target: Target, cases: int, seed: str) -> None:
    left = cases
    for number in itertools.count():
        if left <= 0:
            break
        left -= await _one_socket(target, Mutator(f"{seed} socket {number}"), number, left)
    await target.check("robots' WebSocket")


async def _one_socket(target: Target, mutator: Mutator, number: int, most: int) -> int:
    """Send batches of messages, and at the end what may break the stream; return the number of cases."""
    features, deflate = mutator.choose((FEATURES, FEATURES, "ack", "")), mutator.chance(0.2)
    robot = f"fuzz{number}"
    connection = await join_robot(target.processes.port, robot, features, deflate)
    grammar = FrameGrammar(mutator, robot, "parts" in features, deflate)
    sent = 0
    for batch in range(BATCHES):
        count = min(BATCH, most - sent)
        await connection.send(b"".join(grammar.message() for _ in range(count)))
        sent += count
        mark = f"answer {batch}".encode()
        await connection.send(frame(mark, 9))  # the pong is sent when all messages before have been read
        answered = await connection.until(mark)
        assert answered or b"\x88" in connection.received, f"socket {number}, batch {batch}: closed without a reason"
        del connection.received[:-MAX_RECEIVED]
        if not answered or sent >= most:
            break
    await connection.send(grammar.stream())
    await connection.until_closed()
    return sent + 1
