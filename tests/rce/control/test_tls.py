"""Control connections over mutual TLS."""

from __future__ import annotations

import asyncio
import shutil
import time
from pathlib import Path

import pytest
from twisted.internet.base import ReactorBase

from rce.control import client
from rce.control.calls.watching import Log, ReadLog
from rce.control.client import connect
from rce.control.connection import Handlers
from rce.errors import Unavailable
from rce.net.certificates import Authority
from rce.net.tls import CA, Tls
from tests.support.certificates import certify
from tests.support.control import HELLO, closed, listening


@pytest.fixture(scope="module")
def authority() -> Authority:
    return Authority.make("test")


@pytest.fixture
def own(tmp_path: Path, authority: Authority) -> Tls:
    """Certificates of a machine with the address 127.0.0.1."""
    return Tls(certify(tmp_path / "own", authority, ["127.0.0.1"]))


async def test_calls_over_tls(reactor: ReactorBase, own: Tls) -> None:
    async def read(call: ReadLog) -> Log:
        return Log(["x" * call.lines])

    handlers = Handlers()
    handlers.on(ReadLog, read)
    async with listening(reactor, tls=own) as listener:
        client, server = await listener.pair(handlers, own)
        assert len((await server.call(ReadLog("n", 3_000_000))).lines[0]) == 3_000_000
        await closed(client, server)


@pytest.mark.parametrize(
    "case",
    [
        "client without TLS",
        "client with a certificate of another CA",
        "server with a certificate of another CA",
        "server with a certificate for another address",
        "server without TLS",
    ],
)
async def test_peer_without_a_valid_certificate_cannot_join(
    reactor: ReactorBase,
    own: Tls,
    tmp_path: Path,
    authority: Authority,
    monkeypatch: pytest.MonkeyPatch,
    failures: list[object],
    case: str,
) -> None:
    # Without TLS on one side, the handshake ends only by the timeout: the other side waits for TLS.
    monkeypatch.setattr(client, "JOIN_TIMEOUT", 0.3 if "without TLS" in case else 20.0)
    foreign = Tls(certify(tmp_path / "foreign", Authority.make("other"), ["127.0.0.1"]))
    shutil.copy(tmp_path / "own" / CA, tmp_path / "foreign" / CA)  # it trusts our CA, but we do not trust its own
    elsewhere = Tls(certify(tmp_path / "elsewhere", authority, ["10.0.0.9", "localhost"]))
    server_tls, client_tls = {
        "client without TLS": (own, None),
        "client with a certificate of another CA": (own, foreign),
        "server with a certificate of another CA": (foreign, own),
        "server with a certificate for another address": (elsewhere, own),
        "server without TLS": (None, own),
    }[case]
    async with listening(reactor, tls=server_tls) as listener:
        with pytest.raises(Unavailable):
            await connect(reactor, listener.description, HELLO, Handlers(), client_tls)
        assert listener.joiner.joined.empty()
        assert not failures


async def test_removed_machine_cannot_connect(
    reactor: ReactorBase, own: Tls, tmp_path: Path, authority: Authority
) -> None:
    now = time.time()
    gone = Tls(certify(tmp_path / "gone", authority, ["127.0.0.1"], "gone"))
    again = Tls(certify(tmp_path / "again", authority, ["127.0.0.1"], "gone", after=now - 60))
    async with listening(reactor, tls=own) as listener:
        own.set_removed({"gone": now - 60, "other": now})
        with pytest.raises(Unavailable, match="because the machine was removed"):
            await connect(reactor, listener.description, HELLO, Handlers(), gone)
        assert listener.joiner.joined.empty()
        await closed(*await listener.pair(Handlers(), again))


async def test_connection_of_a_machine_that_is_removed_is_closed(
    reactor: ReactorBase, own: Tls, tmp_path: Path, authority: Authority
) -> None:
    gone = Tls(certify(tmp_path / "gone", authority, ["127.0.0.1"], "gone"))
    async with listening(reactor, tls=own) as listener:
        kept, lost = await listener.pair(Handlers(), own), await listener.pair(Handlers(), gone)
        own.set_removed({"gone": time.time()})
        for end in lost:
            await asyncio.wait_for(end.lost, 30)
        assert not any(end.lost.done() for end in kept)
        await closed(*kept)
