"""Plain HTTP for what is no robot: requests to a platform's entry, errors as those of rce.errors.

Blocking: call it in a thread. Nothing but the standard library, so that a robot's installation has it.
"""

from __future__ import annotations

import base64
import http.client
import ipaddress
import ssl
import urllib.error
import urllib.request
from typing import Any, BinaryIO
from urllib.parse import urljoin, urlsplit

import msgspec
from msgspec import Struct

from rce.errors import ErrorInfo, InvalidRequest, RceError, Unavailable

TIMEOUT = 60.0  # seconds without a byte
PROBLEM = "application/problem+json"
MAX_ANSWER = 16 * 1024 * 1024


class Problem(Struct, frozen=True, omit_defaults=True):
    """An error as HTTP carries it (RFC 9457), with the code and the particulars of ours."""

    title: str
    status: int
    detail: str
    code: str
    field: str = ""
    fields: dict[str, str | int | float | bool | list[str]] = {}
    type: str = "about:blank"


class Entry:
    """The entry at `url`; `headers` go with each request (see `basic` and `bearer`). `direct`: through no proxy."""

    def __init__(
        self, url: str, headers: dict[str, str], context: ssl.SSLContext | None = None, *, direct: bool = False
    ) -> None:
        if urlsplit(url).scheme not in ("http", "https"):
            raise InvalidRequest(f"url {url!r} must begin with http:// or https://", field="url")
        self.url = url if url.endswith("/") else url + "/"
        self._headers = headers
        proxy = urllib.request.ProxyHandler({} if direct or is_loopback(url) else None)
        self._opener = urllib.request.build_opener(proxy, urllib.request.HTTPSHandler(context=context), _NoRedirect())

    def open(self, method: str, path: str, body: bytes | BinaryIO | None = None, **headers: str) -> Any:
        """The answer, to be read and closed. Raises what a problem says, Unavailable when nobody answers."""
        url = urljoin(self.url, path)
        request = urllib.request.Request(url, body, self._headers | headers, method=method)
        try:
            return self._opener.open(request, timeout=TIMEOUT)
        except urllib.error.HTTPError as error:
            with error:
                raise refusal(error.code, error.headers.get_content_type(), _read(error)) from None
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise Unavailable(f"cannot reach {url}: {getattr(error, 'reason', error)}") from None

    def json(self, method: str, path: str, body: Struct | None = None) -> bytes:
        """Ask with a JSON body, and get the answer's."""
        content = None if body is None else msgspec.json.encode(body)
        with self.open(method, path, content, **{"Content-Type": "application/json"}) as answer:
            return _read(answer)


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """The entry never sends one elsewhere, and a credential should not go there."""

    def redirect_request(self, *_: Any) -> None:
        return None


def basic(user: str, secret: str) -> dict[str, str]:
    """Who asks, with an API key or a password."""
    return {"Authorization": "Basic " + base64.b64encode(f"{user}:{secret}".encode()).decode()}


def bearer(token: str) -> dict[str, str]:
    """A token or an API key that says all by itself."""
    return {"Authorization": f"Bearer {token}"}


def refusal(status: int, kind: str, body: bytes) -> RceError:
    """The error that an answer stands for."""
    if kind == PROBLEM:
        try:
            problem = msgspec.json.decode(body, type=Problem)
        except msgspec.DecodeError:
            return Unavailable(f"HTTP status {status} with a problem that cannot be read")
        return RceError.from_info(ErrorInfo(problem.code, problem.detail, "", problem.field, problem.fields))
    text = body[:500].decode(errors="replace").strip()
    return Unavailable(f"HTTP status {status}: {text or 'no reason given'}; is this the entry of a platform?")


def is_loopback(url: str) -> bool:
    host = urlsplit(url).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _read(answer: Any) -> bytes:
    try:
        body: bytes = answer.read(MAX_ANSWER)
    except (OSError, http.client.HTTPException) as error:
        raise Unavailable(f"the answer broke off: {error}") from None
    return body
