"""From the platform's address to an open WebSocket: the Master's HTTP entry, then the Robot endpoint's handshake."""

from __future__ import annotations

import asyncio
import hashlib
import ipaddress
import logging
import socket
import ssl
import urllib.error
import urllib.request
from dataclasses import dataclass
from http.client import HTTPException
from urllib.parse import urlencode, urlsplit, urlunsplit

import msgspec
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidHandshake, InvalidStatus, InvalidURI

from rce.assembler import Limits
from rce.blobs import PART
from rce.errors import AlreadyExists, Forbidden, InvalidRequest, NotFound, RceError, Unauthorized, Unavailable
from rce.messages import CURRENT_VERSION, FEATURES

FEATURES_HEADER = "RCE-Features"
OPEN_TIMEOUT = 10.0
WRITE_LIMIT = 64 * 1024
"""Bytes that may wait below the outbox, in the library and in the kernel: what is there cannot be overtaken."""

_KINDS: dict[int, type[RceError]] = {
    400: InvalidRequest,
    401: Unauthorized,
    403: Forbidden,
    409: AlreadyExists,
    410: InvalidRequest,
    501: InvalidRequest,
}

# At DEBUG websockets logs the request line, in which the credentials stand.
log = logging.getLogger("rce.client.websocket")
log.setLevel(logging.INFO)


@dataclass(frozen=True)
class Address:
    """Where the platform is and who wants in. `url` is that of the Master's entry (http or https).

    Give `password` (in clear; its SHA-256 is sent, as in the original) or `key` (an API key). `compress` asks for
    deflated messages. `ssl` replaces the system's certificates for https and wss. `owner` is whose guest the robot is,
    empty for the user's own.
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
        if urlsplit(self.url).scheme not in ("http", "https"):
            raise InvalidRequest(f"url {self.url!r} must begin with http:// or https://", field="url")
        if (self.password is None) == (self.key is None):
            raise InvalidRequest("give a password or a key, one of the two", field="password")

    async def locate(self) -> str:
        """Ask the entry for the WebSocket address of a Robot endpoint."""
        parts = urlsplit(self.url)
        query = urlencode({"userID": self.user, "version": CURRENT_VERSION})
        url = urlunsplit((parts.scheme, parts.netloc, parts.path or "/", query, ""))
        body = await asyncio.to_thread(self._get, url)
        try:
            return msgspec.json.decode(body, type=dict[str, str])["url"]
        except (msgspec.DecodeError, KeyError) as error:
            raise Unavailable(f"{self.url} is not the entry of a platform: it answered no url ({error})") from None

    def _get(self, url: str) -> bytes:
        proxy = urllib.request.ProxyHandler({} if _is_loopback(url) else None)
        opener = urllib.request.build_opener(proxy, urllib.request.HTTPSHandler(context=self.ssl))
        try:
            with opener.open(url, timeout=OPEN_TIMEOUT) as response:
                body: bytes = response.read(65536)
                return body
        except urllib.error.HTTPError as error:
            with error:
                raise _refusal(error.code, error.read(4096).decode(errors="replace")) from None
        except (OSError, HTTPException, ValueError) as error:
            raise Unavailable(f"cannot reach {self.url}: {getattr(error, 'reason', error)}") from None

    async def dial(self, endpoint: str, token: str) -> ClientConnection:
        """Open the WebSocket of a Robot endpoint; `token` asks for the interfaces of an earlier socket.

        Raises Unauthorized, Forbidden, Unavailable, InvalidRequest, and for a name that is in use AlreadyExists (by a
        server of the original InvalidRequest).
        """
        secret = {"key": self.key} if self.key is not None else {"password": _hash(self.password or "")}
        query = {"userID": self.user, "robotID": self.robot, **secret, "features": ",".join(sorted(FEATURES))}
        if self.compress:
            query["compress"] = "deflate"
        if token:
            query["resume"] = token
        if self.owner:
            query["owner"] = self.owner
        parts = urlsplit(endpoint)
        uri = urlunsplit((parts.scheme, parts.netloc, parts.path or "/", urlencode(query), ""))
        try:
            opened = await connect(
                uri,
                ssl=(self.ssl or True) if parts.scheme == "wss" else None,
                proxy=None if _is_loopback(endpoint) else True,
                compression="deflate" if self.compress else None,
                open_timeout=OPEN_TIMEOUT,
                ping_interval=10,
                close_timeout=2,
                max_size=Limits().message + PART,
                write_limit=WRITE_LIMIT,
                logger=log,
            )
        except InvalidStatus as error:
            answer = error.response
            body = bytes(answer.body or b"").decode(errors="replace")
            if answer.status_code == 404 and body:
                raise NotFound(body.strip()[:500], field="owner") from None
            raise _refusal(answer.status_code, body or answer.reason_phrase) from None
        except InvalidURI:
            raise Unavailable(f"the entry named {endpoint!r}, which is not a WebSocket address") from None
        except (OSError, TimeoutError, InvalidHandshake) as error:
            raise Unavailable(f"cannot reach {endpoint}: {error or 'no answer'}") from None
        _keep_kernel_buffer_small(opened)
        return opened


def _hash(password: str) -> str:
    return hashlib.sha256(password.encode()).hexdigest()


def _is_loopback(url: str) -> bool:
    host = urlsplit(url).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _refusal(status: int, reason: str) -> RceError:
    return _KINDS.get(status, Unavailable)(reason.strip()[:500] or f"HTTP status {status}")


def _keep_kernel_buffer_small(connection: ClientConnection) -> None:
    """Let the kernel take only what it can send at once: the rest waits where a small frame may overtake it."""
    option = getattr(socket, "TCP_NOTSENT_LOWAT", None)
    sock = connection.transport.get_extra_info("socket")
    if option is not None and sock is not None:
        sock.setsockopt(socket.IPPROTO_TCP, option, WRITE_LIMIT)
