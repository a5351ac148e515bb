"""Requests of pages of other origins, such as the dashboard, which is at the Master's port.

Every origin is allowed, because credentials are never ambient: a page must have a key to send, and requests that a
browser could send by itself are refused elsewhere (`rce.web.requests.check_same_site`).
"""

from __future__ import annotations

from aiohttp import web
from aiohttp.typedefs import Handler

MAX_AGE = 600  # seconds for which a browser need not ask again
ALLOWED = {
    "Access-Control-Allow-Methods": "GET, HEAD, POST, PUT, PATCH, DELETE",
    "Access-Control-Allow-Headers": "Authorization, Content-Type, Idempotency-Key, Tus-Resumable, Upload-Length, "
    "Upload-Metadata, Upload-Offset",
    "Access-Control-Max-Age": str(MAX_AGE),
}
EXPOSED = "Location, Upload-Offset, Upload-Length, Upload-Expires, Tus-Resumable"


def allow_origins(application: web.Application) -> None:
    """Let pages of all origins read the answers, and ask before they send."""
    application.middlewares.insert(0, _preflight)
    application.on_response_prepare.append(_mark)


def by_key(request: web.Request) -> bool:
    """Return whether the request has a key, which no browser adds by itself."""
    return request.headers.get("Authorization", "").lower().startswith("bearer ")


@web.middleware
async def _preflight(request: web.Request, handler: Handler) -> web.StreamResponse:
    if request.method == "OPTIONS" and "Access-Control-Request-Method" in request.headers:
        return web.Response(status=204, headers=ALLOWED)
    return await handler(request)


async def _mark(_: web.Request, response: web.StreamResponse) -> None:
    response.headers["Access-Control-Allow-Origin"] = "*"
    response.headers["Access-Control-Expose-Headers"] = EXPOSED
