"""Calls of the HTTP API as its handlers get them, made without a server."""

from __future__ import annotations

from unittest.mock import Mock

from aiohttp.test_utils import make_mocked_request

from master.api.request import AuditDetails, Call
from rce.api.roles import Principal


def make_call(
    principal: Principal | None,
    method: str = "GET",
    path: str = "/",
    content: bytes = b"",
    *,
    parameters: dict[str, str] | None = None,
    variables: dict[str, str] | None = None,
    headers: dict[str, str] | None = None,
) -> Call:
    """Return a call from 10.0.0.1."""
    request = make_mocked_request(method, path, headers, transport=_transport("10.0.0.1"))
    user = principal.user if principal else ""
    return Call(user, principal, variables or {}, "", content, None, parameters or {}, request, AuditDetails())


def _transport(peer: str) -> Mock:
    return Mock(get_extra_info=lambda name, default=None: (peer, 1234) if name == "peername" else default)
