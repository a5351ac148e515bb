"""Enrolment of machines: the Master invites one by name; the machine makes its own key and gets a certificate for it.

Machines join at a port of its own, not at the robots' entry. The entry may have a public certificate and be open to the
world; this port has the platform's own certificate, by whose fingerprint a new machine verifies the Master.
"""

from __future__ import annotations

import hmac
import secrets
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
from aiohttp import web
from aiohttp.typedefs import Handler
from twisted.logger import Logger

import rce
from master.access.join_tokens import JoinTokens
from rce.api.joining import Invitation, JoinCode, JoinRequest, Membership, Role, process_name
from rce.api.views import KeyView
from rce.errors import MALFORMED, InternalError, InvalidRequest, RceError, Unauthorized
from rce.net.certificates import Authority, fingerprint, requested_key_digest
from rce.net.tls import CA
from rce.web.requests import peer_address, read_accepted_body
from rce.web.server import Endpoint, listen, serve_application

HOURS = 24.0
MAX_HOURS = 24.0 * 365
MAX_BODY = 16_384  # bytes
JSON, PEM, GZIP = "application/json", "application/x-pem-file", "application/gzip"
STATUS: dict[type[RceError], int] = {InvalidRequest: 400, Unauthorized: 401}

log = Logger()


async def invite(
    join_tokens: JoinTokens,
    name: str,
    roles: Sequence[Role],
    address: str = "",
    hours: float = HOURS,
    by: KeyView | None = None,
) -> Invitation:
    """Allow a machine of this name to join once within the next hours; one that has joined gets a new certificate.

    `by` is the API key with which this is done: the invitation ends with it.

    Raises:
        InvalidRequest: The name is not a host name, or there is no role.
        Unauthorized: The key was revoked.
    """
    check_name(name)
    if not roles:
        raise InvalidRequest("a machine has the role robot, container or both", field="roles")
    expires = int(time.time() + hours * 3600)
    if by is not None and by.expires is not None:
        expires = min(expires, int(by.expires))
    invitation = Invitation(name, list(dict.fromkeys(roles)), expires, secrets.token_hex(16), address)
    await join_tokens.invite(name, invitation.digest, by.id if by else "")
    return invitation


class Inviter:
    """Issues join codes, each with the URL of the enrolment server and the SHA-256 of the CA's certificate."""

    def __init__(self, join_tokens: JoinTokens, url: str, authority: str) -> None:
        self._join_tokens = join_tokens
        self._url = url
        self._authority = authority

    @staticmethod
    def from_settings(join_tokens: JoinTokens, machines: str, tls: Path | None, address: str) -> Inviter | None:
        """Return an inviter for the settings of these names, or None if they do not allow machines to join."""
        if not machines or tls is None:
            return None
        host = f"[{address}]" if ":" in address else address
        return Inviter(join_tokens, f"https://{host}:{port_of(machines)}/", fingerprint((tls / CA).read_text()))

    async def code(
        self, name: str, roles: Sequence[Role], address: str = "", hours: float = HOURS, by: KeyView | None = None
    ) -> JoinCode:
        """Return a join code for one machine, good once within these hours and while the API key `by` is valid.

        Raises:
            InvalidRequest: As `invite`, or the hours are not above 0 and at most a year.
        """
        if not 0 < hours <= MAX_HOURS:
            raise InvalidRequest(f"a join code is valid for more than 0 and at most {MAX_HOURS:g} hours", field="hours")
        return JoinCode(self._url, self._authority, await invite(self._join_tokens, name, roles, address, hours, by))


def check_name(name: str) -> None:
    """Refuse what is not a host name: it becomes part of certificates and of names of processes.

    Raises:
        InvalidRequest: It is not.
    """
    if not 0 < len(name) <= 63 or not all(part.isalnum() and part.isascii() for part in name.split("-")):
        raise InvalidRequest(
            f"{name!r} is not a name for a machine: use letters, digits and single hyphens between them, at most 63",
            field="name",
        )


def port_of(description: str) -> str:
    """Return the port of a Twisted server endpoint, such as 8080 of `tcp:8080:interface=127.0.0.1`."""
    words = description.split(":")
    return next((word.removeprefix("port=") for word in words if word.startswith("port=")), words[1])


class Registrar:
    """Admits invited machines, and tells them the address (HOST:PORT) for their control connections.

    Addresses of several Masters are separated by commas.
    """

    def __init__(self, join_tokens: JoinTokens, authority: Authority, address: str) -> None:
        self.authority = authority
        self._join_tokens = join_tokens
        self._address = address

    async def admit(self, application: JoinRequest, peer: str) -> Membership:
        """Return the certificate and join tokens of a machine, and use up its invitation.

        A machine that missed the answer asks again with the same key, and gets the same tokens.

        Raises:
            Unauthorized: The invitation is not from this Master, was used, or has expired.
            InvalidRequest: The request is wrong; the invitation stays valid.
        """
        invitation = application.invitation
        if application.version != rce.__version__:
            raise InvalidRequest(
                f"the machine has version {application.version}, the Master {rce.__version__}: install that one there"
            )
        check_name(invitation.name)  # it comes from outside, and goes into the certificate
        address = invitation.address or peer
        hosts, removed = [invitation.name, address, peer], await self._join_tokens.removals()
        certificate = self.authority.issue(application.request, invitation.name, hosts, removed.get(invitation.name, 0))
        key = requested_key_digest(application.request)
        is_valid = invitation.expires >= time.time()
        if not is_valid or not await self._join_tokens.redeem(invitation.name, invitation.digest, key):
            raise Unauthorized(
                "this join code is unknown, was used or has expired: get a new one with `provision machine add`"
            )
        names = {role: process_name(invitation.name, role) for role in invitation.roles}
        tokens = {role: _token(invitation, role, key) for role in invitation.roles}
        for role, token in tokens.items():
            await self._join_tokens.allow(names[role], role, token)
        log.info("machine {name} joined from {peer}", name=invitation.name, peer=peer)
        return Membership(certificate, self._address, address, tokens, names)


def _token(invitation: Invitation, role: Role, key: str) -> str:
    """Return the join token of a process of the machine with this key."""
    return hmac.digest(invitation.secret.encode(), f"{role} {key}".encode(), "sha256").hex()


class EnrolmentServer:
    """HTTP server where machines join.

    `GET /authority` answers with the certificate of the CA, `GET /source` with an archive of RCE, and `POST /machines`
    takes a JoinRequest.
    """

    def __init__(self, registrar: Registrar, source: Path | None) -> None:
        self._registrar = registrar
        application = web.Application(client_max_size=MAX_BODY)
        application.router.add_get("/authority", _serve_bytes(registrar.authority.certificate.encode(), PEM))
        application.router.add_post("/machines", self._admit)
        if source is not None:
            application.router.add_get("/source", _serve_bytes(source.read_bytes(), GZIP))
        self._runner = serve_application(application)

    async def start(self, endpoint: Endpoint) -> tuple[str, int]:
        """Listen, and return the host and port.

        Raises:
            Unavailable: The port is in use or cannot be bound.
        """
        return await listen(self._runner, endpoint)

    async def stop(self) -> None:
        """Close the listening socket and all connections."""
        await self._runner.cleanup()

    async def _admit(self, request: web.Request) -> web.Response:
        peer = peer_address(request)
        try:
            body = await read_accepted_body(request)
            try:
                application = msgspec.json.decode(body, type=JoinRequest)
            except MALFORMED as error:
                raise InvalidRequest(f"the body is not a request to join: {error}") from None
            membership = await self._registrar.admit(application, peer)
            return web.Response(body=msgspec.json.encode(membership), content_type=JSON)
        except (web.HTTPException, ConnectionError):
            raise  # the body is too large or did not come, or the machine disconnected
        except RceError as error:
            log.warn("the machine at {peer} was refused: {error}", peer=peer, error=str(error))
            status = next((status for kind, status in STATUS.items() if isinstance(error, kind)), 500)
            info = error.info
        except Exception:  # noqa: BLE001  # the machine is told of the defect; the traceback goes to the log
            log.failure("defect while a machine joins")
            status, info = 500, InternalError("internal error; the Master's log has the traceback").info
        return web.Response(status=status, body=msgspec.json.encode(info), content_type=JSON)


def _serve_bytes(content: bytes, media_type: str) -> Handler:
    async def handle(request: web.Request) -> web.Response:
        return web.Response(body=content, content_type=media_type)

    return handle
