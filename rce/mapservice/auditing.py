"""Audit log of the changes that clients make; the Master keeps it."""

from __future__ import annotations

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from rce.api.map_jobs import PREFIX
from rce.mapservice.authentication import Authenticator, Client

CLIENT = web.RequestKey("client", Client)
ACTION = web.RequestKey("action", str)
FAILED = web.RequestKey("failed", str)  # code of the error that the client gets
ACTIONS = {
    "POST /uploads": "upload.create",
    "DELETE /uploads/{upload}": "upload.remove",
    "POST /jobs": "job.submit",
    "POST /jobs/{job}/cancel": "job.cancel",
    "DELETE /jobs/{job}": "job.remove",
}
"""Audited routes; not PATCH, of which an upload may need thousands. SOAP handlers set ACTION themselves."""


def audit_middleware(authenticator: Authenticator) -> Middleware:
    """Return a middleware that records each change of an authenticated client, successful or not.

    It stands before `problems`, which makes an answer of every error and sets FAILED to its code.
    """

    @web.middleware
    async def audit(request: web.Request, handler: Handler) -> web.StreamResponse:
        answer = await handler(request)
        _record(authenticator, request, answer.headers.get("Location", ""), request.get(FAILED, "ok"))
        return answer

    return audit


def _record(authenticator: Authenticator, request: web.Request, location: str, result: str) -> None:
    client = request.get(CLIENT)
    resource = request.match_info.route.resource
    path = resource.canonical.removeprefix(PREFIX) if resource else ""
    action = request.get(ACTION) or ACTIONS.get(f"{request.method} {path}", "")
    if client is not None and action:
        thing = [*request.match_info.values(), *([location.rpartition("/")[2]] if location else [])]
        authenticator.record(client, action, "/".join([client.user, *thing]), result, request.remote or "")
