"""Authentication of API requests, and their entries in the audit log."""

from __future__ import annotations

import base64
import re

from aiohttp import web

from master.access.audit import Audit, Origin
from master.access.grants import KEY_PREFIX, digest
from master.access.users import Users
from master.api.request import Answer, Call, Handler
from rce.api.roles import Principal
from rce.errors import Forbidden, RceError, Unauthorized
from rce.web.requests import header, peer_address
from rce.web.server import logged_in

HASH = re.compile(r"[0-9a-f]{64}", re.ASCII)
READ_METHODS = ("GET", "HEAD")


class Authenticator:
    """Checks credentials, and records logins that failed and what was changed."""

    def __init__(self, users: Users, audit: Audit) -> None:
        self._users = users
        self._audit = audit

    async def authenticate(self, request: web.BaseRequest) -> Principal:
        """Return the principal of a request.

        Raises:
            Unauthorized: The credentials are missing or wrong.
            TooManyAttempts: There were too many wrong passwords.
        """
        user, secret = credentials(request)
        try:
            principal = await self._users.check(user, secret, peer_address(request))
        except RceError as error:
            self._audit.note(None, "login", user, user, _origin(request), error)
            raise
        logged_in()
        return principal

    async def audited(self, call: Call, handler: Handler) -> Answer:
        """Return the handler's answer, and record the call if it may have changed something or was forbidden."""
        try:
            answer = await handler(call)
        except BaseException as error:
            if call.method not in READ_METHODS or isinstance(error, Forbidden):
                self._record(call, error)
            raise
        if call.method not in READ_METHODS:
            self._record(call)
        return answer

    def _record(self, call: Call, error: BaseException | None = None) -> None:
        details = call.audit
        operation = details.operation or f"{call.method} {call.raw_path[:50]}"
        owner = details.owner
        parts = [owner, *(part for part in call.path.values() if part != owner), *details.names]
        resource = "/".join(part for part in parts if part)
        principal = call.principal or (Principal(owner, "robot") if owner else None)  # an upload with a ticket
        self._audit.note(principal, operation, owner, resource, _origin(call.request), error)


def credentials(request: web.BaseRequest) -> tuple[str, str]:
    """Return the user, empty with an API key as bearer, and the API key or the SHA-256 of the password in hex.

    With Basic, the secret is a key, a password, or its hash as robots send it. A password that looks like a hash must
    therefore be hashed by the client.

    Raises:
        Unauthorized: There are none, or they are malformed.
    """
    scheme, text = authorization(request)
    if scheme == "bearer" and text.startswith(KEY_PREFIX):
        return "", text
    if scheme == "basic":
        try:
            user, colon, secret = base64.b64decode(text, validate=True).decode().partition(":")
        except ValueError:  # not base64, or not UTF-8 in it
            colon = ""
        if colon:
            hashed = secret.startswith(KEY_PREFIX) or HASH.fullmatch(secret)
            return user, secret if hashed else digest(secret)
    raise Unauthorized(
        "credentials are missing: send Authorization: Bearer with an API key, or Basic with user and password or key"
    )


def authorization(request: web.BaseRequest) -> tuple[str, str]:
    """Return the scheme of the Authorization header, in lower case, and the credentials."""
    scheme, _, text = (header(request, "Authorization") or "").partition(" ")
    return scheme.lower(), text.strip()


def _origin(request: web.BaseRequest) -> Origin:
    return Origin("rest", peer_address(request))
