"""Control connections and their TLS: who is let through, and who is not; and when a plain port is worth a warning."""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path

import pytest
from certified import certify
from test_control import HELLO, LOCAL, Doorman
from twisted.internet.base import ReactorBase

from rce import control
from rce.calls.watching import Log, ReadLog
from rce.certificates import Authority
from rce.control import Handlers, connect, listen
from rce.errors import InvalidRequest, Unavailable
from rce.tls import CA, CERTIFICATE, KEY, Tls, exposed, interface, load


@pytest.fixture(scope="module")
def authority() -> Authority:
    return Authority.make("test")


@pytest.fixture
def own(tmp_path: Path, authority: Authority) -> Tls:
    """Of a machine that is 127.0.0.1."""
    return Tls(certify(tmp_path / "own", authority, ["127.0.0.1"]))


async def test_control_over_tls(reactor: ReactorBase, own: Tls) -> None:
    doorman, handlers = Doorman(), Handlers()

    async def read(call: ReadLog) -> Log:
        return Log(["x" * call.lines])

    handlers.on(ReadLog, read)
    port = await listen(reactor, LOCAL, doorman, own)
    number = port.getHost().port  # type: ignore[misc]
    there, _ = await connect(reactor, f"tcp:127.0.0.1:{number}", HELLO, handlers, own)
    here = await asyncio.wait_for(doorman.joined.get(), 10)
    assert len((await here.call(ReadLog("n", 3_000_000))).lines[0]) == 3_000_000
    there.close()
    await asyncio.wait_for(here.lost, 10)
    await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]


async def test_who_cannot_prove_to_be_of_the_platform_does_not_get_to_join(
    reactor: ReactorBase,
    own: Tls,
    tmp_path: Path,
    authority: Authority,
    monkeypatch: pytest.MonkeyPatch,
    failures: list[object],
) -> None:
    monkeypatch.setattr(control, "JOIN_TIMEOUT", 1.0)  # where one side speaks TLS and the other waits for it
    stranger = Tls(certify(tmp_path / "stranger", Authority.make("other"), ["127.0.0.1"]))
    shutil.copy(tmp_path / "own" / CA, tmp_path / "stranger" / CA)  # it believes us, but we do not believe it
    elsewhere = Tls(certify(tmp_path / "elsewhere", authority, ["10.0.0.9", "localhost"]))
    for server, client, dialled in (
        (own, None, "127.0.0.1"),
        (own, stranger, "127.0.0.1"),
        (stranger, own, "127.0.0.1"),
        (elsewhere, own, "127.0.0.1"),  # a machine of the platform, but another one than was dialled
        (None, own, "127.0.0.1"),
    ):
        doorman = Doorman()
        port = await listen(reactor, LOCAL, doorman, server)
        number = port.getHost().port  # type: ignore[misc]
        with pytest.raises(Unavailable):
            await asyncio.wait_for(connect(reactor, f"tcp:{dialled}:{number}", HELLO, Handlers(), client), 20)
        assert doorman.joined.empty()
        assert not failures
        failures.clear()
        await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]


@pytest.mark.parametrize("broken", [CA, CERTIFICATE, KEY])
def test_files_that_cannot_be_used_are_named(own: Tls, broken: str) -> None:
    (own.directory / broken).write_text("nonsense")
    with pytest.raises(InvalidRequest, match=str(own.directory)):
        load(own.directory)
    (own.directory / broken).unlink()
    with pytest.raises(InvalidRequest, match=broken):
        load(own.directory)


def test_where_plain_connections_can_be_seen(own: Tls) -> None:
    for host, open_to_others in (("127.0.0.1", False), ("::1", False), ("10.0.0.1", True), ("", True), ("m1", True)):
        assert exposed(host, None) == open_to_others
        assert not exposed(host, own)
    assert interface("tcp:8080") == ""
    assert interface(r"tcp:8080:interface=\:\:1") == "::1"
    assert interface("tcp:8080:interface=10.0.0.1:backlog=5") == "10.0.0.1"
    assert interface("unix:/run/rce.sock") == "localhost"
