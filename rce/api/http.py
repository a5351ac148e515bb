"""Blocking HTTP requests to a platform's entry, whose error responses are raised as errors of `rce.errors`.

For use outside of an event loop, or in a thread. Only the standard library and msgspec are needed.

A platform with several Masters has several entries, of which one serves. A request goes to the one that served last. If
that one certainly has not executed it, it goes to the others, for as long as a take-over needs.
"""

from __future__ import annotations

import base64
import http.client
import random
import socket
import ssl
import time
import urllib.error
import urllib.request
from collections import deque
from typing import Any, BinaryIO
from urllib.parse import urljoin, urlsplit

import msgspec
from msgspec import Struct

from rce.api.entries import entries
from rce.errors import MALFORMED, ErrorInfo, RceError, Unavailable
from rce.net.loopback import is_loopback

TIMEOUT = 60.0  # seconds without a byte
# With several Masters:
CONNECT_TIMEOUT = 3.0  # seconds
TAKE_OVER = 15.0  # seconds for which a request waits for a Master that leads
PAUSE = 0.25, 0.75  # seconds between two rounds
PROBLEM = "application/problem+json"
MAX_RESPONSE = 16 * 1024 * 1024


class Problem(Struct, frozen=True, omit_defaults=True):
    """Error response (RFC 9457), extended by the code, the field at fault and the details of an `RceError`."""

    title: str
    status: int
    detail: str
    code: str
    field: str = ""
    fields: dict[str, str | int | float | bool | list[str]] = {}
    type: str = "about:blank"


class NotServed(Unavailable):
    """A request that an entry certainly has not executed: it cannot be reached, or is that of a standby."""


class EntryClient:
    """HTTP client of the platform entry at `url`.

    Attributes:
        url: URL of the entry that served last, with a slash at its end.
    """

    def __init__(
        self, url: str, headers: dict[str, str], context: ssl.SSLContext | None = None, *, direct: bool = False
    ) -> None:
        """Prepare a client; nothing is sent yet.

        Args:
            url: URL of the entry; those of several Masters are separated by commas.
            headers: Headers of each request, such as those of `basic` or `bearer`.
            context: TLS context in place of the system's certificates.
            direct: Ignore the proxy that the environment variables configure.

        Raises:
            InvalidRequest: The URL is not http or https.
        """
        self._urls = deque(each if each.endswith("/") else each + "/" for each in entries(url))
        self._headers = headers
        proxy = urllib.request.ProxyHandler({} if direct or all(map(is_local, self._urls)) else None)
        self._opener = urllib.request.build_opener(proxy, urllib.request.HTTPSHandler(context=context), _NoRedirect())

    @property
    def url(self) -> str:
        """URL of the entry that served last."""
        return self._urls[0]

    def open(self, method: str, path: str, body: bytes | BinaryIO | None = None, **headers: str) -> Any:
        """Make a request and return the response, which the caller must read and close.

        Raises:
            Unavailable: There is no response.
            RceError: The error that the response describes.
        """
        if len(self._urls) == 1:
            return self._open(method, path, body, headers)
        until = time.monotonic() + TAKE_OVER
        while True:
            for _ in range(len(self._urls)):
                try:
                    _check_reachable(self.url)
                    return self._open(method, path, body, headers)
                except NotServed as error:
                    failure = error
                    self._urls.rotate(-1)
            if time.monotonic() > until or not isinstance(body, bytes | None):  # a file may have been read in part
                raise failure
            time.sleep(random.uniform(*PAUSE))  # not all clients at the same moment

    def _open(self, method: str, path: str, body: bytes | BinaryIO | None, headers: dict[str, str]) -> Any:
        url = urljoin(self.url, path)
        request = urllib.request.Request(url, body, self._headers | headers, method=method)
        try:
            return self._opener.open(request, timeout=TIMEOUT)
        except urllib.error.HTTPError as error:
            with error:
                raise error_of_response(error.code, error.headers.get_content_type(), _read(error)) from None
        except urllib.error.URLError as error:  # while it was sent
            raise NotServed(f"cannot reach {url}: {reason_of(error)}") from None
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise Unavailable(f"cannot reach {url}: {reason_of(error)}") from None

    def json(self, method: str, path: str, body: Struct | None = None) -> bytes:
        """Make a request with a JSON body and return the body of the response; raises as `open`."""
        content = None if body is None else msgspec.json.encode(body)
        with self.open(method, path, content, **{"Content-Type": "application/json"}) as response:
            return _read(response)


def _check_reachable(url: str) -> None:
    """Connect, since a Master whose machine is cut off would not refuse a request for a minute.

    Raises:
        NotServed: Nothing answers there.
    """
    parts = urlsplit(url)
    address = parts.hostname or "", parts.port or (443 if parts.scheme == "https" else 80)
    try:
        socket.create_connection(address, CONNECT_TIMEOUT).close()
    except OSError as error:
        raise NotServed(f"cannot reach {url}: {reason_of(error)}") from None


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Handler that follows no redirects: the entry sends none, and credentials must not reach another server."""

    def redirect_request(self, *_: Any) -> None:
        return None


def basic(user: str, secret: str) -> dict[str, str]:
    """Return the header that authenticates with a user's password or API key."""
    return {"Authorization": "Basic " + base64.b64encode(f"{user}:{secret}".encode()).decode()}


def bearer(token: str) -> dict[str, str]:
    """Return the header that authenticates with a token or an API key."""
    return {"Authorization": f"Bearer {token}"}


def error_of_response(status: int, media_type: str, body: bytes) -> RceError:
    """Return the error that a response describes; Unavailable if it does not come from a platform."""
    if media_type == PROBLEM:
        try:
            problem = msgspec.json.decode(body, type=Problem)
        except MALFORMED:
            return Unavailable(f"HTTP status {status} with a malformed problem document")
        info = ErrorInfo(problem.code, problem.detail, "", problem.field, problem.fields)
        if status == 503 and "leader" in problem.fields:
            standby = NotServed(problem.detail)
            standby.info = info
            return standby
        return RceError.from_info(info)
    text = body[:500].decode(errors="replace").strip()
    return Unavailable(f"HTTP status {status}: {text or 'no reason given'}; is this the entry of a platform?")


def is_local(url: str) -> bool:
    """Return True if the URL's host is this machine."""
    return is_loopback(urlsplit(url).hostname or "")


def reason_of(error: Exception) -> str:
    """Return in words why a request got no response."""
    reason = getattr(error, "reason", error)
    if isinstance(reason, ConnectionRefusedError):
        return "connection refused. Does the platform run there?"
    return (isinstance(reason, OSError) and reason.strerror) or str(reason)


def _read(response: Any) -> bytes:
    try:
        body: bytes = response.read(MAX_RESPONSE)
    except (OSError, http.client.HTTPException) as error:
        raise Unavailable(f"the connection broke during the response: {error}") from None
    return body
