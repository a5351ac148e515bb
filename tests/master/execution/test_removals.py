"""Removal of machines: their processes are disconnected, and their certificates are refused everywhere."""

from __future__ import annotations

import asyncio
import datetime
import ssl
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import pytest
from cryptography import x509

import rce
from containers.data_relay import DataRelay
from master.access.enrolment import Registrar, invite
from master.execution import removals
from rce.api.joining import JoinRequest
from rce.control.calls.environments import StartEnvironment
from rce.control.calls.joining import Hello, SetRemovedMachines
from rce.control.client import connect
from rce.control.connection import Control, Handlers
from rce.errors import NotFound, Unauthorized, Unavailable
from rce.net.certificates import Authority, generate_key, key_to_pem, signing_request
from rce.net.relay_handshake import RelayRequest
from rce.net.sockets import bind_unix_socket
from rce.net.tls import CA, CERTIFICATE, KEY, Tls
from tests.support.certificates import certify
from tests.support.master.peers import PATIENCE, Furnished, Platform

Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def test_process_whose_credentials_were_revoked_is_disconnected(furnished: Furnished) -> None:
    master = furnished.platform.master
    await master.removals.check()
    assert "west" in master.state.joined
    await master.join_tokens.remove_machine("west")  # as `rce machine remove` does, beside the Master
    await master.removals.check()
    assert "west" not in master.state.joined
    await furnished.platform.until(lambda: furnished.west.control.lost.done())
    with pytest.raises(Unauthorized):
        await furnished.platform.endpoint(token=furnished.west.credential)


async def test_removals_beside_the_master_are_found(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(removals, "INTERVAL", 0.01)
    await platform.stop()
    await platform.start()  # with the shorter interval
    west = await platform.endpoint()
    await platform.master.join_tokens.remove_machine("west")
    await platform.until(lambda: west.control.lost.done())


async def test_removed_machine_is_not_listed_and_its_environments_have_no_credentials(furnished: Furnished) -> None:
    master = furnished.platform.master
    await master.removals.remove("m1")
    assert "m1" not in master.state.processes
    assert master.state.environments["ann/brain"].machine == ""
    with pytest.raises(Unauthorized):
        await furnished.platform.process("environment", "ann/brain", token=furnished.brain.credential)
    m2 = await furnished.platform.process("container", "m2", capacity=4)
    assert (await m2.next(StartEnvironment)).environment.name == "ann/brain"


async def test_unknown_machine_cannot_be_removed(platform: Platform) -> None:
    with pytest.raises(NotFound):
        await platform.master.removals.remove("m7")
    assert platform.master.state.removed_machines == {}


async def test_processes_are_told_of_removals_at_once_and_when_they_join(platform: Platform) -> None:
    west = await platform.endpoint()
    await platform.process("container", "m1")
    await platform.master.removals.remove("m1")
    told = await west.next(SetRemovedMachines)
    assert list(told.machines) == ["m1"]
    await platform.stop()
    await platform.start()  # the removal outlives the Master
    assert await (await platform.process("container", "m2")).next(SetRemovedMachines) == told


class Machine(NamedTuple):
    """A machine that joined by an invitation."""

    tls: Tls
    token: str


class Trial:
    """A Master with TLS, and a machine `far` with a data relay for an environment that echoes."""

    def __init__(self, platform: Platform, directory: Path) -> None:
        self.platform = platform
        self.directory = directory
        self.authority = Authority.make("test")
        self.tls = Tls(certify(directory / "far", self.authority, ["127.0.0.1"], "far"))
        self.relay = DataRelay(self.tls)

    async def start(self) -> None:
        await self.platform.stop()
        self.platform.tls = Tls(certify(self.directory / "master", self.authority, ["127.0.0.1"], "alpha"))
        await self.platform.start()
        await self.relay.listen("127.0.0.1", 0)
        listener = bind_unix_socket(self.directory / "data.sock")
        self.echo = await asyncio.start_unix_server(_echo, sock=listener)
        await self.relay.add_environment("ann/brain", self.directory / "data.sock", self.directory)
        handlers = Handlers()
        handlers.do(SetRemovedMachines, lambda call: self.tls.set_removed(call.machines))
        await self.platform.master.join_tokens.allow("far", "container", "far")
        await self.join("far", self.tls, "far", handlers)

    async def join(self, name: str, tls: Tls, token: str, handlers: Handlers) -> Control:
        hello = Hello("container", name, token, rce.__version__, "1")
        control, _ = await connect(self.platform.reactor, self.platform.address, hello, handlers, tls)
        self.platform.controls.append(control)
        return control

    async def enrol(self, name: str) -> Machine:
        tokens, key = self.platform.master.join_tokens, generate_key()
        invitation = await invite(tokens, name, ["container"], "127.0.0.1")
        request = JoinRequest(invitation, signing_request(key, name), rce.__version__)
        membership = await Registrar(tokens, self.authority, "").admit(request, "127.0.0.1")
        directory = self.directory / membership.tokens["container"]
        directory.mkdir()
        for file, text in ((CA, self.authority.certificate), (KEY, key_to_pem(key))):
            (directory / file).write_text(text)
        (directory / CERTIFICATE).write_text(membership.certificate)
        return Machine(Tls(directory), membership.tokens["container"])

    async def dial(self, tls: Tls) -> Streams:
        """Connect to the environment through the relay, and wait for an answer of it."""
        host, _, port = self.relay.address.removeprefix("relay:").rpartition(":")
        reader, writer = await asyncio.open_connection(host, int(port), ssl=tls.client)
        writer.write(RelayRequest("ann/brain").line() + b"hello\n")
        if await asyncio.wait_for(reader.readline(), PATIENCE) != b"hello\n":
            raise ConnectionError("closed by the relay")
        return reader, writer

    async def stop(self) -> None:
        self.echo.close()
        await self.relay.close()


async def _echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(ConnectionError, asyncio.CancelledError):
        while line := await reader.readline():
            writer.write(line)
    writer.close()


async def test_certificate_of_a_removed_machine_is_void_and_that_of_its_successor_is_good(
    platform: Platform, tmp_path: Path
) -> None:
    """Everything over real sockets with TLS: enrolment, control connections and links through a relay."""
    trial = Trial(platform, tmp_path)
    await trial.start()
    lost = await trial.enrol("near")
    control = await trial.join("near", lost.tls, lost.token, Handlers())
    reader, _ = await trial.dial(lost.tls)

    await platform.master.removals.remove("near")
    await asyncio.wait_for(control.lost, PATIENCE)
    with suppress(ConnectionError):
        assert await asyncio.wait_for(reader.read(), PATIENCE) == b""  # the open link is closed
    with pytest.raises((OSError, ssl.SSLError)):
        await trial.dial(lost.tls)
    with pytest.raises(Unavailable):  # before it may say anything
        await trial.join("near", lost.tls, lost.token, Handlers())

    found = await trial.enrol("near")
    await platform.until(lambda: not _is_too_early(found.tls))
    await trial.join("near", found.tls, found.token, Handlers())
    _, writer = await trial.dial(found.tls)
    writer.close()
    with pytest.raises((OSError, ssl.SSLError)):
        await trial.dial(lost.tls)
    await trial.stop()


def _is_too_early(tls: Tls) -> bool:
    """Return whether a certificate is not valid yet, as in the second of the removal.

    OpenSSL reads the clock with `time`, whose seconds begin up to a tick of the kernel late (10 ms at most).
    """
    certificate = x509.load_pem_x509_certificate((tls.directory / CERTIFICATE).read_bytes())
    tick = datetime.timedelta(milliseconds=20)
    return certificate.not_valid_before_utc + tick > datetime.datetime.now(datetime.UTC)
