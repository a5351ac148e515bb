"""The Master's control port: Perspective Broker from strangers, and calls of processes that have joined."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from typing import Any

import pytest
from twisted.internet.base import ReactorBase
from twisted.internet.error import ConnectionDone
from twisted.spread import pb

import rce
from rce.bench.hollow import Hollow
from rce.control.calls.joining import Hello, Welcome
from rce.control.client import connect
from rce.control.connection import Control
from rce.errors import RceError
from tests.support.fuzz import calls
from tests.support.fuzz.mutation import Mutator
from tests.support.fuzz.sockets import PATIENCE, RawConnection
from tests.support.fuzz.target import NAMES, TOKENS, Target

pytestmark = pytest.mark.slow

AT_ONCE = 20
JOINED = 50  # calls of one connection
HELLO = [b"tuple", [b"list", b"page"], [b"remote", 1]]
CONVERSATION: list[Any] = [
    b"pb",
    [b"version", 6],
    [b"message", 1, b"root", b"join", 1, HELLO, [b"dictionary"]],
    [b"message", 2, 1, b"call", 1, [b"tuple", b"\x94\xabReadMetrics\xa0\x00\x80"], [b"dictionary"]],
    [b"message", 3, 1, b"call", 1, [b"tuple", b"\x94", b"\xa0\xa0\x00\x80", 7], [b"dictionary", [b"x", 1]]],
    [b"answer", 1, [b"tuple", [b"boolean", b"true"], [b"list"]]],
    [b"answer", 1, [b"tuple", b"\x92\xc3\x80"]],
    [b"error", 1, [b"unicode", b"x"]],
    [b"decref", 1],
    [b"ping"],
    [b"pong"],
    [b"cache", 1, 2],
    [b"lcache", 1],
    [b"method", b"x", [b"None"], [b"function", b"os.system"]],
]


@pytest.mark.share(0.05)
async def test_strangers_are_refused(target: Target, cases: int, seed: str) -> None:
    mutator = Mutator(f"{seed} strangers")
    port = int(target.control.rpartition(":")[2])
    for start in range(0, cases, AT_ONCE):
        sent = [_conversation(mutator) for _ in range(min(AT_ONCE, cases - start))]
        await asyncio.gather(*(_talk(port, mutator.pieces(each, 3)) for each in sent))
    await target.check("control port, strangers")


def _conversation(mutator: Mutator) -> bytes:
    messages = list(CONVERSATION) if mutator.chance(0.3) else CONVERSATION[:3]
    kept = [each if mutator.chance(0.5) else mutator.structure(each, 2) for each in messages]
    data = b"".join(map(calls.encode, kept))
    return mutator.damage(data) if mutator.chance(0.4) else data


async def _talk(port: int, pieces: list[bytes]) -> None:
    connection = await RawConnection.open(port)
    for piece in pieces:
        await connection.send(piece)
    await connection.until_closed()


class Member:
    """A process that joins again and again, each time with a Hello that is changed a little."""

    def __init__(self, reactor: ReactorBase, address: str, role: str) -> None:
        self._reactor, self._address = reactor, address
        self.hello = Hello(role, NAMES[role], TOKENS[role], rce.__version__, incarnation=secrets.token_hex(4))

    async def join(self) -> Control:
        control, welcome = await connect(self._reactor, self._address, self.hello, Hollow().handlers())
        self._keep(welcome)
        return control

    def _keep(self, welcome: Welcome) -> None:
        self.hello = Hello(
            self.hello.role, self.hello.name, welcome.credential, rce.__version__, incarnation=secrets.token_hex(4)
        )


@pytest.mark.share(0.04)
@pytest.mark.parametrize("role", ["robot", "container"])
async def test_each_call_of_a_process_is_answered(
    target: Target, reactor: ReactorBase, cases: int, seed: str, role: str
) -> None:
    mutator = Mutator(f"{seed} {role}")
    member = Member(reactor, target.control, role)
    known = calls.examples()
    for start in range(0, cases, JOINED):
        control = await member.join()
        for _ in range(min(JOINED, cases - start)):
            name = mutator.choose(tuple(known))
            if await _call(control, mutator, name, known[name]):
                break
        control.close()
        with contextlib.suppress(ConnectionDone):
            await asyncio.wait_for(asyncio.shield(control.lost), PATIENCE)
    await target.check(f"control port, {role}")


async def _call(control: Control, mutator: Mutator, name: str, value: Any) -> bool:
    """Send one mutated call; return True if the Master closes the connection for it."""
    content = calls.pages(name, mutator.structure(value))
    if mutator.chance(0.1):
        content = [mutator.damage(content[0])]
    try:
        async with asyncio.timeout(PATIENCE):
            await control._receiver.callRemote("call", *content).asFuture(asyncio.get_running_loop())
    except (pb.DeadReferenceError, pb.PBConnectionLost):
        return True
    except (pb.Error, pb.RemoteError, RceError, ValueError):
        return False
    return False
