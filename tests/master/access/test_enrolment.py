"""Enrolment of machines at the Master: invitations, certificates, tokens, and the server for them."""

from __future__ import annotations

import http.client
import time
from asyncio import to_thread
from collections.abc import AsyncIterator
from pathlib import Path

import msgspec
import pytest
from cryptography import x509

import rce
from master.access.enrolment import (
    MAX_BODY,
    MAX_HOURS,
    EnrolmentServer,
    Inviter,
    Registrar,
    check_name,
    invite,
    port_of,
)
from master.access.join_tokens import JoinTokens
from master.access.users import Users
from master.storage.store import Store
from rce.api.joining import Invitation, JoinRequest, Membership, parse_join_code
from rce.errors import InvalidRequest, Unauthorized
from rce.net.certificates import Authority, certificate_hosts, fingerprint, generate_key, signing_request
from rce.net.tls import CA
from rce.web.server import Endpoint

REQUEST = signing_request(generate_key(), "machine")
AUTHORITY = Authority.make("tests")


@pytest.fixture
def tokens(store: Store) -> JoinTokens:
    return JoinTokens(store)


@pytest.fixture
def registrar(tokens: JoinTokens) -> Registrar:
    return Registrar(tokens, AUTHORITY, "alpha:8080")


def apply(invitation: Invitation, request: str = REQUEST, version: str = rce.__version__) -> JoinRequest:
    return JoinRequest(invitation, request, version)


# --- invitations ------------------------------------------------------------------------------------------------------


async def test_invitation_is_for_some_hours(tokens: JoinTokens) -> None:
    before = time.time()
    invitation = await invite(tokens, "beta", ["robot", "robot", "container"], "10.0.0.2", 2)
    assert (invitation.name, invitation.roles, invitation.address) == ("beta", ["robot", "container"], "10.0.0.2")
    assert before + 7199 <= invitation.expires <= time.time() + 7200
    assert await tokens.redeem("beta", invitation.digest, "key")


async def test_machine_without_a_role_is_not_invited(tokens: JoinTokens) -> None:
    with pytest.raises(InvalidRequest) as raised:
        await invite(tokens, "beta", [])
    assert raised.value.field == "roles"


@pytest.mark.parametrize("name", ["a", "beta-2", "B", "x" * 63])
def test_host_names_are_names_of_machines(name: str) -> None:
    check_name(name)


@pytest.mark.parametrize("name", ["", "a b", "a/b", "a.b", "-a", "a-", "a--b", "x" * 64, "ä", "٣"])
async def test_other_names_are_refused(tokens: JoinTokens, name: str) -> None:
    with pytest.raises(InvalidRequest, match="not a name for a machine") as raised:
        await invite(tokens, name, ["robot"])
    assert raised.value.field == "name"


async def test_join_code_has_all_that_a_machine_needs(tokens: JoinTokens) -> None:
    inviter = Inviter(tokens, "https://alpha:8081/", "f" * 64)
    code = await inviter.code("beta", ["container"], "10.0.0.2", MAX_HOURS)
    assert parse_join_code(code.text()) == code
    assert (code.url, code.authority, code.invitation.address) == ("https://alpha:8081/", "f" * 64, "10.0.0.2")


@pytest.mark.parametrize("hours", [0.0, -1.0, MAX_HOURS + 1, float("inf"), float("nan")])
async def test_join_code_cannot_be_expired_or_endless(tokens: JoinTokens, hours: float) -> None:
    with pytest.raises(InvalidRequest) as raised:
        await Inviter(tokens, "https://alpha:8081/", "f" * 64).code("beta", ["robot"], "", hours)
    assert raised.value.field == "hours"


@pytest.mark.parametrize(
    ("machines", "address", "url"),
    [
        ("tcp:8081", "alpha", "https://alpha:8081/"),
        ("tcp:8081:interface=10.0.0.1", "10.0.0.1", "https://10.0.0.1:8081/"),
        ("tcp:8081", "2001:db8::1", "https://[2001:db8::1]:8081/"),
    ],
)
async def test_settings_give_the_url_of_join_codes(
    tokens: JoinTokens, tmp_path: Path, machines: str, address: str, url: str
) -> None:
    (tmp_path / CA).write_text(AUTHORITY.certificate)
    inviter = Inviter.from_settings(tokens, machines, tmp_path, address)
    assert inviter is not None
    code = await inviter.code("beta", ["robot"])
    assert (code.url, code.authority) == (url, fingerprint(AUTHORITY.certificate))


def test_no_machines_are_invited_without_the_settings(tokens: JoinTokens, tmp_path: Path) -> None:
    assert Inviter.from_settings(tokens, "", tmp_path, "alpha") is None
    assert Inviter.from_settings(tokens, "tcp:8081", None, "alpha") is None


@pytest.mark.parametrize(
    "text", ["tcp:8080", "tcp:8080:interface=10.0.0.1", "tcp:port=8080", "tcp:interface=x:port=8080"]
)
def test_port_of(text: str) -> None:
    assert port_of(text) == "8080"


# --- admission --------------------------------------------------------------------------------------------------------


async def test_invited_machine_gets_a_certificate_and_tokens(registrar: Registrar, tokens: JoinTokens) -> None:
    membership = await registrar.admit(apply(await invite(tokens, "beta", ["robot", "container"])), "10.0.0.7")
    assert (membership.master, membership.address) == ("alpha:8080", "10.0.0.7")
    assert certificate_hosts(membership.certificate) == ["beta", "10.0.0.7"]
    assert membership.names == {"robot": "beta-robot", "container": "beta"}
    for role, token in membership.tokens.items():
        assert await tokens.admit(membership.names[role], role, token)


async def test_address_of_the_invitation_is_preferred(registrar: Registrar, tokens: JoinTokens) -> None:
    invitation = await invite(tokens, "beta", ["robot"], "beta.example")
    membership = await registrar.admit(apply(invitation), "10.0.0.7")
    assert membership.address == "beta.example"
    assert certificate_hosts(membership.certificate) == ["beta", "beta.example", "10.0.0.7"]


async def test_invitation_is_valid_for_one_machine(registrar: Registrar, tokens: JoinTokens) -> None:
    invitation = await invite(tokens, "beta", ["robot"])
    first = await registrar.admit(apply(invitation), "10.0.0.7")
    other = signing_request(generate_key(), "machine")
    with pytest.raises(Unauthorized):
        await registrar.admit(apply(invitation, other), "10.0.0.7")
    again = await registrar.admit(apply(invitation), "10.0.0.7")  # its answer was lost
    assert again.tokens == first.tokens
    await tokens.remove_machine("beta")
    with pytest.raises(Unauthorized):
        await registrar.admit(apply(invitation), "10.0.0.7")


async def test_tokens_belong_to_one_key(registrar: Registrar, tokens: JoinTokens) -> None:
    """They cannot be derived from a join code that is found later."""
    invitation = await invite(tokens, "beta", ["robot", "container"])
    membership = await registrar.admit(apply(invitation), "10.0.0.7")
    assert len({*membership.tokens.values(), invitation.secret}) == 3
    for role, token in membership.tokens.items():
        await tokens.admit(membership.names[role], role, token, "c" * 64)
        with pytest.raises(Unauthorized):
            await tokens.admit(membership.names[role], role, token)


async def test_machine_that_is_added_again_has_a_later_certificate(registrar: Registrar, tokens: JoinTokens) -> None:
    first = await registrar.admit(apply(await invite(tokens, "beta", ["robot"])), "10.0.0.7")
    await tokens.remove_machine("beta")
    removed = (await tokens.removals())["beta"]
    second = await registrar.admit(apply(await invite(tokens, "beta", ["robot"])), "10.0.0.7")
    begins = [_valid_from(each.certificate) for each in (first, second)]
    assert begins[0] < removed < begins[1]


def _valid_from(certificate: str) -> float:
    return x509.load_pem_x509_certificate(certificate.encode()).not_valid_before_utc.timestamp()


async def test_altered_and_expired_invitations_are_refused(registrar: Registrar, tokens: JoinTokens) -> None:
    expired = await invite(tokens, "beta", ["robot"], hours=-1)
    extended = msgspec.structs.replace(expired, expires=int(time.time()) + 100)
    fresh = await invite(tokens, "gamma", ["robot"])
    more = msgspec.structs.replace(fresh, roles=["robot", "container"])
    other = msgspec.structs.replace(fresh, name="alpha")
    for invitation in (expired, extended, more, other):
        with pytest.raises(Unauthorized):
            await registrar.admit(apply(invitation), "10.0.0.7")
    assert await registrar.admit(apply(fresh), "10.0.0.7")


async def test_wrong_request_does_not_use_up_the_invitation(registrar: Registrar, tokens: JoinTokens) -> None:
    invitation = await invite(tokens, "beta", ["robot"])
    for wrong in (apply(invitation, version="0.0.1"), apply(invitation, "nonsense"), apply(invitation, "")):
        with pytest.raises(InvalidRequest):
            await registrar.admit(wrong, "10.0.0.7")
    assert await registrar.admit(apply(invitation), "10.0.0.7")


@pytest.mark.parametrize("name", ["", "a/b", "x" * 1000])
async def test_forged_invitation_with_an_impossible_name_is_refused(registrar: Registrar, name: str) -> None:
    forged = Invitation(name, ["robot"], int(time.time()) + 100, "0" * 32)
    with pytest.raises(InvalidRequest, match="not a name for a machine"):
        await registrar.admit(apply(forged), "10.0.0.7")


# --- server -----------------------------------------------------------------------------------------------------------


class Served:
    """An enrolment server without TLS, which it leaves to its listener."""

    def __init__(self, port: int) -> None:
        self.port = port

    async def ask(self, method: str, path: str, body: bytes = b"") -> tuple[int, str, bytes]:
        """Return the status, the content type and the body of an answer."""

        def ask() -> tuple[int, str, bytes]:
            connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
            connection.request(method, path, body, {"Connection": "close"})
            answer = connection.getresponse()
            contents = answer.read()
            connection.close()
            return answer.status, answer.headers.get_content_type(), contents

        return await to_thread(ask)


@pytest.fixture
async def served(registrar: Registrar, tmp_path: Path) -> AsyncIterator[Served]:
    source = tmp_path / "source.tar.gz"
    source.write_bytes(b"the source")
    server = EnrolmentServer(registrar, source)
    _, port = await server.start(Endpoint("127.0.0.1", 0))
    yield Served(port)
    await server.stop()


async def test_server_admits_a_machine(served: Served, tokens: JoinTokens) -> None:
    body = msgspec.json.encode(apply(await invite(tokens, "beta", ["robot"])))
    status, kind, contents = await served.ask("POST", "/machines", body)
    assert (status, kind) == (200, "application/json")
    membership = msgspec.json.decode(contents, type=Membership)
    assert (membership.address, membership.names) == ("127.0.0.1", {"robot": "beta-robot"})
    other = signing_request(generate_key(), "machine")
    body = msgspec.json.encode(msgspec.structs.replace(msgspec.json.decode(body, type=JoinRequest), request=other))
    status, _, contents = await served.ask("POST", "/machines", body)
    assert (status, msgspec.json.decode(contents)["code"]) == (401, "unauthorized")


async def test_authority_and_source_can_be_fetched(served: Served) -> None:
    assert await served.ask("GET", "/authority") == (200, "application/x-pem-file", AUTHORITY.certificate.encode())
    assert await served.ask("GET", "/source") == (200, "application/gzip", b"the source")


async def test_source_is_missing_unless_it_is_set(registrar: Registrar) -> None:
    server = EnrolmentServer(registrar, None)
    _, port = await server.start(Endpoint("127.0.0.1", 0))
    assert (await Served(port).ask("GET", "/source"))[0] == 404
    await server.stop()


@pytest.mark.parametrize(
    ("body", "status"),
    [(b"", 400), (b"{}", 400), (b"[1]", 400), (b"\xff", 400), (b"x" * MAX_BODY, 400), (b"x" * (MAX_BODY + 1), 413)],
)
async def test_malformed_request_is_refused(served: Served, body: bytes, status: int) -> None:
    assert (await served.ask("POST", "/machines", body))[0] == status


async def test_defect_is_not_told(
    served: Served, registrar: Registrar, failures: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fail(application: JoinRequest, peer: str) -> Membership:
        raise ZeroDivisionError("the secret is 7")

    monkeypatch.setattr(registrar, "admit", fail)
    forged = Invitation("beta", ["robot"], 0, "0")
    status, _, contents = await served.ask("POST", "/machines", msgspec.json.encode(apply(forged)))
    assert (status, msgspec.json.decode(contents)["code"]) == (500, "internal")
    assert b"secret" not in contents
    assert len(failures) == 1


async def test_invitation_ends_with_the_key_with_which_it_was_made(store: Store) -> None:
    users, tokens = Users(store), JoinTokens(store)
    await users.add("olga", "x", "operator")
    _, key = await users.keys.add("olga", "operator", expires=time.time() + 60)
    invitation = await invite(tokens, "beta", ["robot"], by=key)
    assert invitation.expires <= (key.expires or 0)
    await users.keys.revoke("olga", key.id)
    assert not await tokens.redeem("beta", invitation.digest, "key")
    with pytest.raises(Unauthorized):
        await invite(tokens, "beta", ["robot"], by=key)
