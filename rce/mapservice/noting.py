"""What clients change here is told to the Master, for the audit log."""

from __future__ import annotations

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from rce.errors import RceError
from rce.map_jobs import PREFIX
from rce.mapservice.access import Access, Client

CLIENT = web.RequestKey("client", Client)
ACTION = web.RequestKey("action", str)
FAILED = web.RequestKey("failed", str)
ACTIONS = {
    "POST /uploads": "upload.create",
    "DELETE /uploads/{upload}": "upload.remove",
    "POST /jobs": "job.submit",
    "POST /jobs/{job}/cancel": "job.cancel",
    "DELETE /jobs/{job}": "job.remove",
}
"""Not the pieces of an upload: there may be thousands. SOAP says itself what it does."""


def noting(access: Access) -> Middleware:
    """Notes each change that a client who is known has made, or was not let make."""

    @web.middleware
    async def note(request: web.Request, handler: Handler) -> web.StreamResponse:
        try:
            answer = await handler(request)
        except RceError as error:
            _note(access, request, "", error.info.code)
            raise
        _note(access, request, answer.headers.get("Location", ""), request.get(FAILED, "ok"))
        return answer

    return note


def _note(access: Access, request: web.Request, location: str, result: str) -> None:
    client = request.get(CLIENT)
    resource = request.match_info.route.resource
    path = resource.canonical.removeprefix(PREFIX) if resource else ""
    action = request.get(ACTION) or ACTIONS.get(f"{request.method} {path}", "")
    if client is not None and action:
        thing = [*request.match_info.values(), *([location.rpartition("/")[2]] if location else [])]
        access.note(client, action, "/".join([client.user, *thing]), result, request.remote or "")
