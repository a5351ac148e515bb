"""Machines that join: certificates, one-time invitations, authentication of the Master by a fingerprint."""

from __future__ import annotations

import asyncio
import os
import ssl
import time
from collections.abc import AsyncIterator
from pathlib import Path

import msgspec
import pytest
from twisted.internet.base import ReactorBase

from master.access.enrolment import EnrolmentServer, Registrar, invite
from master.access.join_tokens import JoinTokens
from master.storage.store import Store
from provisioning import identity
from rce.api.joining import JoinCode, Membership, parse_join_code
from rce.errors import InvalidRequest, Unauthorized, Unavailable
from rce.net.certificates import Authority, certificate_hosts, fingerprint
from rce.web import requests
from rce.web.server import parse_endpoint

CONTROL = "127.0.0.1:8080"


class Platform:
    """The parts of a Master that a joining machine uses."""

    def __init__(self, directory: Path, processes: JoinTokens) -> None:
        self.processes = processes
        self.tls = directory / "tls"
        self.tls.mkdir()
        identity.make(self.tls, self.tls / "ca.key", "alpha", ["127.0.0.1"])
        self.authority = Authority.load(self.tls / "ca.pem", self.tls / "ca.key")
        self.source = directory / "source.tar.gz"
        self.source.write_bytes(b"the source")
        self.url = ""

    async def open(self) -> None:
        self.server = EnrolmentServer(Registrar(self.processes, self.authority, CONTROL), self.source)
        keys = f"privateKey={self.tls / 'key.pem'}:certKey={self.tls / 'cert.pem'}"
        _, port = await self.server.start(parse_endpoint(f"ssl:0:interface=127.0.0.1:{keys}"))
        self.url = f"https://127.0.0.1:{port}/"

    async def close(self) -> None:
        await self.server.stop()

    async def code(self, name: str = "beta", **options: float) -> JoinCode:
        invitation = await invite(self.processes, name, ["robot", "container"], **options)  # type: ignore[arg-type]
        return parse_join_code(JoinCode(self.url, fingerprint(self.authority.certificate), invitation).text())


@pytest.fixture
async def platform(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[Platform]:
    store = Store("sqlite://")
    await store.open()
    platform = Platform(tmp_path, JoinTokens(store))
    await platform.open()
    yield platform
    await platform.close()
    await store.close()


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    (tmp_path / "machine").mkdir()
    return tmp_path / "machine"


async def join(machine: Path, code: JoinCode) -> Membership:
    return await asyncio.to_thread(identity.join, machine, code)


async def test_machine_joins(platform: Platform, machine: Path) -> None:
    membership = await join(machine, await platform.code())
    assert membership.master == CONTROL
    assert membership.names == {"robot": "beta-robot", "container": "beta"}
    assert certificate_hosts((machine / "cert.pem").read_text()) == ["beta", "127.0.0.1"]
    assert (machine / "ca.pem").read_text() == platform.authority.certificate
    assert (machine / "key.pem").stat().st_mode & 0o777 == 0o600
    for role, token in membership.tokens.items():
        credential = await platform.processes.admit(membership.names[role], role, token)
        assert credential != token
    assert await platform.processes.names() == ["beta", "beta-robot"]


async def test_certificates_authenticate_both_sides(platform: Platform, machine: Path) -> None:
    """Mutual TLS with strict verification."""
    await join(machine, await platform.code())
    server = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=str(platform.tls / "ca.pem"))
    server.load_cert_chain(platform.tls / "cert.pem", platform.tls / "key.pem")
    server.verify_mode = ssl.CERT_REQUIRED
    client = ssl.create_default_context(cafile=str(machine / "ca.pem"))
    client.load_cert_chain(machine / "cert.pem", machine / "key.pem")
    for context in (server, client):
        context.verify_flags |= ssl.VERIFY_X509_STRICT

    async def greet(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(str(writer.get_extra_info("peercert")["subject"]).encode())
        writer.close()

    async with await asyncio.start_server(greet, "127.0.0.1", 0, ssl=server) as listening:
        port = listening.sockets[0].getsockname()[1]
        reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=client)
        assert b"beta" in await reader.read()
        writer.close()


async def test_invitation_is_valid_once(platform: Platform, machine: Path) -> None:
    code = await platform.code()
    await join(machine, code)
    with pytest.raises(Unauthorized, match="was used"):
        await join(machine, code)


async def test_machine_whose_answer_was_lost_joins_again(
    platform: Platform, machine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ask = identity._ask

    def lose(url: str, trust: ssl.SSLContext, method: str, path: str, body: bytes | None = None) -> tuple[int, bytes]:
        answer = ask(url, trust, method, path, body)
        if method == "POST":
            raise Unavailable("connection reset")
        return answer

    code = await platform.code()
    monkeypatch.setattr(identity, "_ask", lose)
    with pytest.raises(Unavailable):
        await join(machine, code)
    assert os.listdir(machine) == ["joining.pem"]
    assert (machine / "joining.pem").stat().st_mode & 0o777 == 0o600
    monkeypatch.undo()
    membership = await join(machine, code)
    assert sorted(os.listdir(machine)) == ["ca.pem", "cert.pem", "key.pem"]
    ssl.create_default_context().load_cert_chain(machine / "cert.pem", machine / "key.pem")
    await platform.processes.admit("beta", "container", membership.tokens["container"])


async def test_body_that_does_not_come_is_not_waited_for(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requests, "BODY_TIMEOUT", 0.05)
    trusted = ssl.create_default_context(cafile=str(platform.tls / "ca.pem"))
    port = int(platform.url.rstrip("/").rpartition(":")[2])
    reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=trusted)
    writer.write(b"POST /machines HTTP/1.1\r\nHost: x\r\nContent-Length: 100\r\n\r\n{")
    assert (await asyncio.wait_for(reader.readline(), 20)).split()[1] == b"408"
    writer.close()


async def test_new_invitation_revokes_the_earlier_one(platform: Platform, machine: Path) -> None:
    first = await platform.code()
    second = await platform.code()
    with pytest.raises(Unauthorized):
        await join(machine, first)
    await join(machine, second)


async def test_invitation_expires(platform: Platform, machine: Path) -> None:
    with pytest.raises(Unauthorized, match="has expired"):
        await join(machine, await platform.code(hours=-1))


async def test_altered_invitation_is_refused(platform: Platform, machine: Path) -> None:
    code = await platform.code(hours=-1)
    later = msgspec.structs.replace(code.invitation, expires=int(time.time()) + 100)
    with pytest.raises(Unauthorized):
        await join(machine, msgspec.structs.replace(code, invitation=later))
    fresh = await platform.code()
    other = msgspec.structs.replace(fresh.invitation, name="alpha")
    with pytest.raises(Unauthorized):
        await join(machine, msgspec.structs.replace(fresh, invitation=other))
    assert not (machine / "cert.pem").exists()


async def test_invitation_is_not_a_credential_of_a_process(platform: Platform) -> None:
    code = await platform.code()
    with pytest.raises(Unauthorized):
        await platform.processes.admit("beta", "machine", msgspec.json.encode(code.invitation).decode())


async def test_invitation_is_not_sent_to_an_unknown_server(platform: Platform, machine: Path) -> None:
    """Another server answers at the Master's address. The invitation stays valid."""
    code = await platform.code()
    with pytest.raises(InvalidRequest, match="nothing was sent"):
        await join(machine, msgspec.structs.replace(code, authority="0" * 64))
    assert await platform.processes.redeem("beta", code.invitation.digest, "key")


async def test_server_with_the_right_ca_but_without_its_key_is_refused(
    platform: Platform, machine: Path, tmp_path: Path
) -> None:
    """The CA's certificate is public."""
    code = await platform.code()
    (tmp_path / "impostor").mkdir()
    impostor = Platform(tmp_path / "impostor", platform.processes)
    impostor.authority = platform.authority
    await impostor.open()
    with pytest.raises(Unavailable, match="certificate verify failed"):
        await join(machine, msgspec.structs.replace(code, url=impostor.url))
    await impostor.close()
    assert await platform.processes.redeem("beta", code.invitation.digest, "key")


async def test_refused_version_does_not_use_up_the_invitation(
    platform: Platform, machine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = await platform.code()
    with monkeypatch.context() as patched:
        patched.setattr(identity, "__version__", "0.0.1")
        with pytest.raises(InvalidRequest, match=r"version 0\.0\.1"):
            await join(machine, code)
    await join(machine, code)


def test_ca_and_valid_certificate_are_kept(tmp_path: Path) -> None:
    identity.make(tmp_path, tmp_path / "ca.key", "alpha", ["10.0.0.1"])
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert identity.make(tmp_path, tmp_path / "ca.key", "alpha", ["10.0.0.1"]) == "kept"
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    identity.make(tmp_path, tmp_path / "ca.key", "alpha", ["10.0.0.2"])
    assert certificate_hosts((tmp_path / "cert.pem").read_text()) == ["10.0.0.2"]
    assert (tmp_path / "ca.pem").read_bytes() == before["ca.pem"]


def test_malformed_signing_request_is_refused() -> None:
    authority = Authority.make("test")
    for text in ("", "nonsense", authority.certificate):
        with pytest.raises(InvalidRequest, match="not a certificate signing request"):
            authority.issue(text, "beta", ["beta"])
