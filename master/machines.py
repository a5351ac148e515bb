"""How machines join: the Master invites one by name, and it comes with a key of its own and gets its certificate.

The port for this is not the robots' entry: that one may have a public certificate and be open to the world, this one
has the platform's own, by which a new machine knows the Master, and is for machines.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
from twisted.internet.defer import Deferred
from twisted.logger import Logger
from twisted.web import http
from twisted.web.resource import Resource
from twisted.web.server import NOT_DONE_YET, Request

import rce
from master.processes import Processes
from rce.certificates import Authority, fingerprint
from rce.errors import InternalError, InvalidRequest, RceError, Unauthorized
from rce.joining import Application, Invitation, JoinCode, Membership, Role, process_name
from rce.tls import CA

HOURS = 24.0
LARGEST_BODY = 16_384
STATUS = {InvalidRequest: http.BAD_REQUEST, Unauthorized: http.UNAUTHORIZED}

log = Logger()


async def invite(
    processes: Processes, name: str, roles: Sequence[Role], address: str = "", hours: float = HOURS
) -> Invitation:
    """Let a machine of this name join once within the next hours; one that is there already gets new papers."""
    check_name(name)
    if not roles:
        raise InvalidRequest("a machine has the role robot, container or both", field="roles")
    expires = int(time.time() + hours * 3600)
    invitation = Invitation(name, list(dict.fromkeys(roles)), expires, secrets.token_hex(16), address)
    await processes.invite(name, invitation.digest)
    return invitation


class Inviter:
    """Writes join codes. `url` is that of the Registry, `authority` the SHA-256 of the certificate that is known by."""

    def __init__(self, processes: Processes, url: str, authority: str) -> None:
        self._processes = processes
        self._url = url
        self._authority = authority

    @staticmethod
    def of(processes: Processes, machines: str, tls: Path | None, address: str) -> Inviter | None:
        """By the settings of these names; None if the Master takes no machines in."""
        if not machines or tls is None:
            return None
        host = f"[{address}]" if ":" in address else address
        return Inviter(processes, f"https://{host}:{port_of(machines)}/", fingerprint((tls / CA).read_text()))

    async def code(self, name: str, roles: Sequence[Role], address: str = "", hours: float = HOURS) -> JoinCode:
        """For one machine, once, within these hours."""
        return JoinCode(self._url, self._authority, await invite(self._processes, name, roles, address, hours))


def check_name(name: str) -> None:
    """Refuse what is no host name: it goes into certificates and names of processes."""
    if not 0 < len(name) <= 63 or not all(part.isalnum() and part.isascii() for part in name.split("-")):
        raise InvalidRequest(
            f"{name!r} is no name for a machine: letters, digits and single hyphens between them, at most 63",
            field="name",
        )


def port_of(description: str) -> str:
    """The port of a Twisted server endpoint such as tcp:8080:interface=…"""
    words = description.split(":")
    return next((word.removeprefix("port=") for word in words if word.startswith("port=")), words[1])


class Registrar:
    """Takes invited machines in. `address` is the HOST:PORT of the control connections that they shall make."""

    def __init__(self, processes: Processes, authority: Authority, address: str) -> None:
        self.authority = authority
        self._processes = processes
        self._address = address

    async def admit(self, application: Application, peer: str) -> Membership:
        """Unauthorized if the invitation is not ours, was used, or is too old; InvalidRequest if it can be used again
        after mending the application."""
        invitation = application.invitation
        if application.version != rce.__version__:
            raise InvalidRequest(
                f"the machine has version {application.version}, the Master {rce.__version__}: install that one there"
            )
        address = invitation.address or peer
        certificate = self.authority.issue(application.request, invitation.name, [invitation.name, address, peer])
        if invitation.expires < time.time() or not await self._processes.redeem(invitation.name, invitation.digest):
            raise Unauthorized(
                "this join code is unknown, was used or is too old: get a new one with `provision machine add`"
            )
        names = {role: process_name(invitation.name, role) for role in invitation.roles}
        tokens = {role: secrets.token_hex(32) for role in invitation.roles}
        for role, token in tokens.items():
            await self._processes.allow(names[role], role, token)
        log.info("machine {name} joined from {peer}", name=invitation.name, peer=peer)
        return Membership(certificate, self._address, address, tokens, names)


class Registry(Resource):
    """`GET /authority` is the CA's certificate, `GET /source` RCE itself, `POST /machines` an Application."""

    def __init__(self, registrar: Registrar, source: Path | None) -> None:
        super().__init__()  # type: ignore[no-untyped-call]  # Twisted's
        children = {
            b"authority": _Fixed(registrar.authority.certificate.encode(), "application/x-pem-file"),
            b"machines": _Machines(registrar),
        }
        if source is not None:
            children[b"source"] = _Fixed(source.read_bytes(), "application/gzip")
        for name, child in children.items():
            self.putChild(name, child)  # type: ignore[arg-type]  # zope declares it otherwise


class SmallRequest(Request):
    """Refuses large bodies before they are read."""

    def gotLength(self, length: int | None) -> None:
        if length is None or length > LARGEST_BODY:
            self.channel.forceAbortClient()
        super().gotLength(min(length or 0, LARGEST_BODY))  # type: ignore[no-untyped-call]


class _Fixed(Resource):
    isLeaf = True

    def __init__(self, content: bytes, kind: str) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self._content = content
        self._kind = kind

    def render_GET(self, request: Request) -> bytes:
        request.setHeader("content-type", self._kind)
        return self._content


class _Machines(Resource):
    isLeaf = True

    def __init__(self, registrar: Registrar) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self._registrar = registrar

    def render_POST(self, request: Request) -> int:
        content = request.content
        assert content is not None
        answer = asyncio.ensure_future(self._answer(content.read(), request.getClientAddress().host))
        Deferred.fromFuture(answer).addCallback(lambda result: _finish(request, *result))
        return NOT_DONE_YET

    async def _answer(self, body: bytes, peer: str) -> tuple[int, bytes]:
        try:
            try:
                application = msgspec.json.decode(body, type=Application)
            except msgspec.DecodeError as error:
                raise InvalidRequest(f"this is no application of a machine: {error}") from None
            return http.OK, msgspec.json.encode(await self._registrar.admit(application, peer))
        except RceError as error:
            log.warn("a machine at {peer} was refused: {error}", peer=peer, error=str(error))
            status = next(
                (code for kind, code in STATUS.items() if isinstance(error, kind)), http.INTERNAL_SERVER_ERROR
            )
            return status, msgspec.json.encode(error.info)
        except Exception:  # noqa: BLE001  # the machine must hear of a defect here; the traceback stays in this log
            log.failure("defect while a machine joins")
            return http.INTERNAL_SERVER_ERROR, msgspec.json.encode(InternalError("see the Master's log").info)


def _finish(request: Request, status: int, body: bytes) -> None:
    if request._disconnected:
        return
    request.setResponseCode(status)
    request.setHeader("content-type", "application/json")
    request.write(body)
    request.finish()
