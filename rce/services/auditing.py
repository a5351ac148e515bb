"""Audit log of the changes that clients make; the Master keeps it."""

from __future__ import annotations

from collections.abc import Mapping

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from rce.services.authentication import Authenticator, Client

CLIENT = web.RequestKey("client", Client)
ACTION = web.RequestKey("action", str)
FAILED = web.RequestKey("failed", str)  # code of the error that the client gets
SECRET = "key"  # part of a path that is a credential, and is not recorded


def audit_middleware(authenticator: Authenticator, prefix: str, actions: Mapping[str, str]) -> Middleware:
    """Return a middleware that records each change of an authenticated client, successful or not.

    `actions` has the name of the action for each audited route, as `POST /jobs`, without the prefix of all paths. A
    handler that serves several actions sets ACTION itself.

    It stands before `problems`, which makes an answer of every error and sets FAILED to its code.
    """

    @web.middleware
    async def audit(request: web.Request, handler: Handler) -> web.StreamResponse:
        answer = await handler(request)
        resource = request.match_info.route.resource
        path = resource.canonical.removeprefix(prefix) if resource else ""
        action = request.get(ACTION) or actions.get(f"{request.method} {path}", "")
        client = request.get(CLIENT)
        if client is not None and action:
            location = answer.headers.get("Location", "")
            named = [value for name, value in request.match_info.items() if name != SECRET]
            thing = [*named, *([location.rpartition("/")[2]] if location else [])]
            result = request.get(FAILED, "ok")
            authenticator.record(client, action, "/".join([client.user, *thing]), result, request.remote or "")
        return answer

    return audit
