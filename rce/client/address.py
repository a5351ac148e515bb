"""Connection set-up: the Master's HTTP entry, which assigns a Robot endpoint, and that endpoint's handshake."""

from __future__ import annotations

import asyncio
import hashlib
import ssl
import urllib.error
import urllib.request
from dataclasses import dataclass
from http.client import HTTPException
from urllib.parse import urlencode, urlsplit, urlunsplit

import msgspec
from websockets.exceptions import InvalidURI

from rce.api.entries import entries
from rce.api.http import is_local, reason_of
from rce.client.dialing import dial, proxy_of
from rce.client.websocket import Refused, WebSocket, open_websocket
from rce.errors import (
    MALFORMED,
    AlreadyExists,
    Forbidden,
    InvalidRequest,
    NotFound,
    RceError,
    Unauthorized,
    Unavailable,
)
from rce.protocol.messages import CURRENT_VERSION, FEATURES

FEATURES_HEADER = "RCE-Features"
OPEN_TIMEOUT = 10.0

_ERROR_BY_STATUS: dict[int, type[RceError]] = {
    400: InvalidRequest,
    401: Unauthorized,
    403: Forbidden,
    409: AlreadyExists,
    410: InvalidRequest,
    501: InvalidRequest,
}


@dataclass(frozen=True)
class Address:
    """Address of a platform and the credentials of a robot.

    Attributes:
        url: URL of the Master's entry (http or https); those of several Masters are separated by commas.
        user: User name.
        robot: robotID.
        password: Password in clear; its SHA-256 is sent, as the original protocol requires. Give this or `key`.
        key: API key.
        compress: Compress messages (permessage-deflate) in both directions.
        ssl: TLS context for https and wss in place of the system's certificates.
        owner: User whose data a guest takes part in; empty for the user's own.
    """

    url: str
    user: str
    robot: str
    password: str | None = None
    key: str | None = None
    compress: bool = False
    ssl: ssl.SSLContext | None = None
    owner: str = ""

    def __post_init__(self) -> None:
        entries(self.url)
        if (self.password is None) == (self.key is None):
            raise InvalidRequest("give either a password or an API key", field="password")

    async def locate(self, patient: bool = False) -> str:
        """Ask the Master's entry for the WebSocket address of a Robot endpoint; of several Masters, the one that leads.

        Args:
            patient: Wait until the entry can be reached, for OPEN_TIMEOUT at most.

        Raises:
            Unavailable: The entry cannot be reached or is not that of an RCE platform.
            RceError: The entry refuses the request, for example an unknown user.
        """
        asked = [asyncio.create_task(self._ask(entry, patient)) for entry in entries(self.url)]
        try:
            for answer in asyncio.as_completed(asked):
                try:
                    return await answer
                except Unavailable as error:
                    failure = error
        finally:
            for each in asked:
                each.cancel()
            await asyncio.gather(*asked, return_exceptions=True)
        raise failure

    async def _ask(self, entry: str, patient: bool) -> str:
        parts = urlsplit(entry)
        query = urlencode({"userID": self.user, "version": CURRENT_VERSION})
        url = urlunsplit((parts.scheme, parts.netloc, parts.path or "/", query, ""))
        if patient and proxy_of("ws" + entry.removeprefix("http")) is None:
            port = parts.port or (443 if parts.scheme == "https" else 80)
            try:
                (await dial(parts.hostname or "", port, OPEN_TIMEOUT)).close()
            except OSError as error:  # also TimeoutError
                raise Unavailable(f"cannot reach {entry}: {str(error) or 'no answer'}") from None
        body = await asyncio.to_thread(self._get, entry, url)
        try:
            return msgspec.json.decode(body, type=dict[str, str])["url"]
        except (*MALFORMED, KeyError) as error:
            raise Unavailable(
                f"{entry} is not the entry of an RCE platform: its answer contains no url ({error})"
            ) from None

    def _get(self, entry: str, url: str) -> bytes:
        proxy = urllib.request.ProxyHandler({} if is_local(url) else None)
        opener = urllib.request.build_opener(proxy, urllib.request.HTTPSHandler(context=self.ssl))
        try:
            with opener.open(url, timeout=OPEN_TIMEOUT) as response:
                body: bytes = response.read(65536)
                return body
        except urllib.error.HTTPError as error:
            with error:
                raise _error_of_status(error.code, error.read(4096).decode(errors="replace")) from None
        except (OSError, HTTPException, ValueError) as error:
            raise Unavailable(f"cannot reach {entry}: {reason_of(error)}") from None

    @property
    def secret(self) -> dict[str, str]:
        """The parameter of a request that carries the password or the key."""
        return {"key": self.key} if self.key is not None else {"password": password_digest(self.password or "")}

    async def dial(self, endpoint: str, token: str) -> WebSocket:
        """Open the WebSocket of a Robot endpoint.

        Args:
            endpoint: WebSocket URL, as returned by `locate`.
            token: Resumption token of an earlier connection, or an empty string for a new session.

        Raises:
            Unauthorized: The credentials are wrong.
            Forbidden: The credentials do not permit this robot.
            NotFound: `owner` does not exist.
            AlreadyExists: The robotID is in use. A server of the original raises InvalidRequest instead.
            InvalidRequest: The server rejects the request for another reason.
            Unavailable: The endpoint cannot be reached.
        """
        query = {"userID": self.user, "robotID": self.robot, **self.secret, "features": ",".join(sorted(FEATURES))}
        if self.compress:
            query["compress"] = "deflate"
        if token:
            query["resume"] = token
        if self.owner:
            query["owner"] = self.owner
        parts = urlsplit(endpoint)
        uri = urlunsplit((parts.scheme, parts.netloc, parts.path or "/", urlencode(query), ""))
        try:
            return await open_websocket(
                uri, OPEN_TIMEOUT, tls=self.ssl, direct=is_local(endpoint), compress=self.compress
            )
        except Refused as refusal:
            raise _error_of(refusal) from None
        except InvalidURI:
            raise Unavailable(
                f"the entry {self.url} assigned the endpoint {endpoint!r}, which is not a WebSocket URL"
            ) from None
        except Unavailable as error:
            raise Unavailable(f"cannot reach {endpoint}: {error}") from None


def password_digest(password: str) -> str:
    """Return what is sent in place of a password."""
    return hashlib.sha256(password.encode()).hexdigest()


def _error_of(refusal: Refused) -> RceError:
    if refusal.status == 404 and not refusal.standard:
        return NotFound(str(refusal).strip()[:500], field="owner")
    return _error_of_status(refusal.status, str(refusal))


def _error_of_status(status: int, reason: str) -> RceError:
    return _ERROR_BY_STATUS.get(status, Unavailable)(reason.strip()[:500] or f"HTTP status {status}")
