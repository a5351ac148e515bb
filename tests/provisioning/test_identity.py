"""A machine joins a Master that it knows by a fingerprint only: certificates, one-time invitations, strangers."""

from __future__ import annotations

import asyncio
import ssl
import time
from collections.abc import AsyncIterator
from pathlib import Path

import msgspec
import pytest
from twisted.internet import endpoints
from twisted.internet.base import ReactorBase
from twisted.web.server import Site

from master.machines import Registrar, Registry, SmallRequest, invite, port_of
from master.processes import Processes
from master.store import Store
from provisioning import identity
from provisioning.joincode import parse as parse_plan
from provisioning.steps import Failed
from rce.certificates import Authority, fingerprint, hosts_of
from rce.errors import InvalidRequest, RceError, Unauthorized, Unavailable
from rce.joining import Invitation, JoinCode, parse

CONTROL = "127.0.0.1:8080"


class Platform:
    """A Master as far as a machine that joins sees it."""

    def __init__(self, reactor: ReactorBase, directory: Path, processes: Processes) -> None:
        self.reactor = reactor
        self.processes = processes
        self.tls = directory / "tls"
        self.tls.mkdir()
        identity.make(self.tls, self.tls / "ca.key", "alpha", ["127.0.0.1"])
        self.authority = Authority.load(self.tls / "ca.pem", self.tls / "ca.key")
        self.source = directory / "source.tar.gz"
        self.source.write_bytes(b"the source")
        self.url = ""

    async def open(self) -> None:
        registry = Registry(Registrar(self.processes, self.authority, CONTROL), self.source)
        keys = f"privateKey={self.tls / 'key.pem'}:certKey={self.tls / 'cert.pem'}"
        endpoint = endpoints.serverFromString(self.reactor, f"ssl:0:interface=127.0.0.1:{keys}")
        site = Site(registry, requestFactory=SmallRequest)
        self.port = await endpoint.listen(site).asFuture(asyncio.get_running_loop())
        self.url = f"https://127.0.0.1:{self.port.getHost().port}/"

    async def close(self) -> None:
        await self.port.stopListening().asFuture(asyncio.get_running_loop())

    async def code(self, name: str = "beta", **options: float) -> JoinCode:
        invitation = await invite(self.processes, name, ["robot", "container"], **options)  # type: ignore[arg-type]
        return parse(JoinCode(self.url, fingerprint(self.authority.certificate), invitation).text())


@pytest.fixture
async def platform(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[Platform]:
    store = Store("sqlite://")
    await store.open()
    platform = Platform(reactor, tmp_path, Processes(store))
    await platform.open()
    yield platform
    await platform.close()
    await store.close()


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    (tmp_path / "machine").mkdir()
    return tmp_path / "machine"


async def join(machine: Path, code: JoinCode) -> identity.Membership:
    return await asyncio.to_thread(identity.join, machine, code)


async def test_a_machine_joins(platform: Platform, machine: Path) -> None:
    membership = await join(machine, await platform.code())
    assert membership.master == CONTROL
    assert membership.names == {"robot": "beta-robot", "container": "beta"}
    assert hosts_of((machine / "cert.pem").read_text()) == ["beta", "127.0.0.1"]
    assert (machine / "ca.pem").read_text() == platform.authority.certificate
    assert (machine / "key.pem").stat().st_mode & 0o777 == 0o600
    for role, token in membership.tokens.items():
        credential = await platform.processes.admit(membership.names[role], role, token)
        assert credential != token
    assert await platform.processes.names() == ["beta", "beta-robot"]


async def test_both_sides_know_each_other_by_their_certificates(platform: Platform, machine: Path) -> None:
    """Mutual TLS, by the strictest rules that this Python has."""
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


async def test_an_invitation_is_good_once(platform: Platform, machine: Path) -> None:
    code = await platform.code()
    await join(machine, code)
    with pytest.raises(Unauthorized, match="was used"):
        await join(machine, code)


async def test_a_new_invitation_voids_the_earlier_one(platform: Platform, machine: Path) -> None:
    first = await platform.code()
    second = await platform.code()
    with pytest.raises(Unauthorized):
        await join(machine, first)
    await join(machine, second)


async def test_an_invitation_ends(platform: Platform, machine: Path) -> None:
    with pytest.raises(Unauthorized, match="too old"):
        await join(machine, await platform.code(hours=-1))


async def test_an_invitation_cannot_be_altered(platform: Platform, machine: Path) -> None:
    code = await platform.code(hours=-1)
    later = msgspec.structs.replace(code.invitation, expires=int(time.time()) + 100)
    with pytest.raises(Unauthorized):
        await join(machine, msgspec.structs.replace(code, invitation=later))
    fresh = await platform.code()
    other = msgspec.structs.replace(fresh.invitation, name="alpha")
    with pytest.raises(Unauthorized):
        await join(machine, msgspec.structs.replace(fresh, invitation=other))
    assert not (machine / "cert.pem").exists()


async def test_an_invitation_is_no_credential_of_a_process(platform: Platform) -> None:
    code = await platform.code()
    with pytest.raises(Unauthorized):
        await platform.processes.admit("beta", "machine", msgspec.json.encode(code.invitation).decode())


async def test_a_machine_tells_a_stranger_nothing(platform: Platform, machine: Path) -> None:
    """Somebody else answers at the Master's address: the invitation is not sent, and stays good."""
    code = await platform.code()
    with pytest.raises(InvalidRequest, match="nothing was sent"):
        await join(machine, msgspec.structs.replace(code, authority="0" * 64))
    assert await platform.processes.redeem("beta", code.invitation.digest)


async def test_a_stranger_who_shows_the_true_authority(platform: Platform, machine: Path, tmp_path: Path) -> None:
    """Its certificate is public, its key is not."""
    code = await platform.code()
    (tmp_path / "stranger").mkdir()
    stranger = Platform(platform.reactor, tmp_path / "stranger", platform.processes)
    stranger.authority = platform.authority
    await stranger.open()
    with pytest.raises(Unavailable, match="certificate verify failed"):
        await join(machine, msgspec.structs.replace(code, url=stranger.url))
    await stranger.close()
    assert await platform.processes.redeem("beta", code.invitation.digest)


async def test_another_version_is_refused_and_may_try_again(
    platform: Platform, machine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = await platform.code()
    with monkeypatch.context() as patched:
        patched.setattr(identity, "__version__", "0.0.1")
        with pytest.raises(InvalidRequest, match=r"version 0\.0\.1"):
            await join(machine, code)
    await join(machine, code)


@pytest.mark.parametrize("body", [b"", b"{}", b"[1]", b"\xff", b"x" * 20_000])
async def test_applications_that_are_none(platform: Platform, body: bytes) -> None:
    trust = ssl.create_default_context(cadata=platform.authority.certificate)
    try:
        status, _ = await asyncio.to_thread(identity._ask, platform.url, trust, "POST", "machines", body)
    except Unavailable:
        assert len(body) > 16_384  # the connection was closed
    else:
        assert status == 400


async def test_the_source_can_be_fetched(platform: Platform) -> None:
    trust = ssl.create_default_context(cadata=platform.authority.certificate)
    assert await asyncio.to_thread(identity._ask, platform.url, trust, "GET", "source") == (200, b"the source")


def test_the_authority_and_a_good_certificate_are_kept(tmp_path: Path) -> None:
    identity.make(tmp_path, tmp_path / "ca.key", "alpha", ["10.0.0.1"])
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert identity.make(tmp_path, tmp_path / "ca.key", "alpha", ["10.0.0.1"]) == "kept"
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    identity.make(tmp_path, tmp_path / "ca.key", "alpha", ["10.0.0.2"])
    assert hosts_of((tmp_path / "cert.pem").read_text()) == ["10.0.0.2"]
    assert (tmp_path / "ca.pem").read_bytes() == before["ca.pem"]


def test_what_is_no_request_is_not_signed() -> None:
    authority = Authority.make("test")
    for text in ("", "nonsense", authority.certificate):
        with pytest.raises(InvalidRequest, match="no certificate request"):
            authority.issue(text, "beta", ["beta"])


@pytest.mark.parametrize("text", ["", "nonsense", "rce1-", "rce1-e30", "rce1-ÿ"])
def test_codes_that_are_none(text: str) -> None:
    with pytest.raises(InvalidRequest, match="no join code"):
        parse(text)
    with pytest.raises(Failed, match="no join code"):
        parse_plan(text)


def test_the_plan_reads_the_same_code() -> None:
    invitation = Invitation("beta", ["container"], 1, "s")
    code = JoinCode("https://10.0.0.1:8081/", "ab", invitation)
    plan = parse_plan(f"  {code.text()}\n")
    assert (plan.url, plan.name, plan.roles) == (code.url, "beta", ("container",))
    assert parse(code.text()) == code


@pytest.mark.parametrize("name", ["", "a b", "a/b", "-a", "a--b", "x" * 64, "ä"])
async def test_names_that_are_none(platform: Platform, name: str) -> None:
    with pytest.raises(RceError, match="no name for a machine"):
        await platform.code(name)


@pytest.mark.parametrize(
    "text", ["tcp:8080", "tcp:8080:interface=10.0.0.1", "tcp:port=8080", "tcp:interface=x:port=8080"]
)
def test_port_of(text: str) -> None:
    assert port_of(text) == "8080"
