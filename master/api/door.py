"""Who makes a request, and what is noted of it in the audit log."""

from __future__ import annotations

import base64
import re

from twisted.web.server import Request

from master.api.calls import Answer, Call, Handler
from master.audit import Audit, Origin
from master.grants import KEY_PREFIX, digest
from master.users import Users
from rce.errors import Forbidden, RceError, Unauthorized
from rce.roles import Principal

HASH = re.compile(r"[0-9a-f]{64}", re.ASCII)
READS = ("GET", "HEAD")


class Door:
    """The way in over HTTP."""

    def __init__(self, users: Users, audit: Audit) -> None:
        self._users = users
        self._audit = audit

    async def enter(self, request: Request) -> Principal:
        """Who it is. Unauthorized, TooManyAttempts."""
        user, secret = credentials(request)
        try:
            return await self._users.check(user, secret, host_of(request))
        except RceError as error:
            self._audit.note(None, "login", user, user, _origin(request), error)
            raise

    async def audited(self, call: Call, handler: Handler) -> Answer:
        """What the handler answers; whatever it may have changed is noted, and what was forbidden."""
        try:
            answer = await handler(call)
        except BaseException as error:
            if _method(call) not in READS or isinstance(error, Forbidden):
                self._note(call, error)
            raise
        if _method(call) not in READS:
            self._note(call)
        return answer

    def _note(self, call: Call, error: BaseException | None = None) -> None:
        trail = call.trail
        action = trail.operation or f"{_method(call)} {call.request.path.decode('ascii', 'replace')[:50]}"
        owner = trail.owner
        parts = [owner, *(part for part in call.path.values() if part != owner), *trail.names]
        thing = "/".join(part for part in parts if part)
        who = call.principal or (Principal(owner, "robot") if owner else None)  # with a ticket of theirs
        self._audit.note(who, action, owner, thing, _origin(call.request), error)


def credentials(request: Request) -> tuple[str, str]:
    """An API key as bearer, whose user is not named, or `user:secret` as basic. Unauthorized.

    The secret is a key, a password, or its SHA-256 in hex, as robots send it: a password that looks like one must be
    hashed by who sends it.
    """
    kind, text = authorization(request)
    if kind == "bearer" and text.startswith(KEY_PREFIX):
        return "", text
    if kind == "basic":
        try:
            user, colon, secret = base64.b64decode(text, validate=True).decode().partition(":")
        except ValueError:  # no base64, or no UTF-8 in it
            colon = ""
        if colon:
            hashed = secret.startswith(KEY_PREFIX) or HASH.fullmatch(secret)
            return user, secret if hashed else digest(secret)
    raise Unauthorized("say who you are: Authorization: Bearer API-KEY, or Basic with user and password or key")


def authorization(request: Request) -> tuple[str, str]:
    """The kind of the credentials, in lower case, and the credentials."""
    kind, _, text = (request.getHeader("authorization") or "").partition(" ")
    return kind.lower(), text.strip()


def host_of(request: Request) -> str:
    """The address that a request came from."""
    return str(getattr(request.getClientAddress(), "host", ""))


def _origin(request: Request) -> Origin:
    return Origin("rest", host_of(request))


def _method(call: Call) -> str:
    return call.request.method.decode("ascii", "replace")
