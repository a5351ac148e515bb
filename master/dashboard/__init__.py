"""The dashboard at `/ui/`: the files of `web/` as they are, and those of the JavaScript client below `/ui/rce/`.

Pages of the browser belong into `web/`; this module serves them and has no logic of theirs.
"""

from __future__ import annotations

import hashlib
import re
from base64 import b64encode
from pathlib import Path
from typing import NamedTuple

from aiohttp import web

import rce
from master.entry import query_parameters, text_response
from master.graph.state import State
from master.redirect import absolute_url
from rce.web.requests import header, host_name, raw_path, raw_query

PREFIX = "/ui/"
HOST = re.compile(r"[A-Za-z0-9.:\[\]-]+", re.ASCII)
MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".ts": "text/plain; charset=utf-8",
    ".txt": "text/plain; charset=utf-8",
}
FOLDERS = {"": Path(__file__).parent / "web", "rce/": Path(rce.__file__).parent / "js"}
CONTENT_SECURITY_POLICY = (
    "default-src 'self'; script-src 'self' {scripts}; connect-src {sources}; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'; object-src 'none'; style-src 'self'{styles}"
)
INLINE_STYLES = frozenset({"terminal.html"})  # xterm.js writes its colours and sizes into style elements


INLINE_SCRIPT = re.compile(rb"<script>(.*?)</script>", re.DOTALL)


class StaticFile(NamedTuple):
    """A file that is served, with its media type, entity tag, and the hashes of the scripts inside it."""

    body: bytes
    media_type: str
    etag: str
    scripts: str


def load_files() -> dict[str, StaticFile]:
    """Return the files that are served, by their paths below PREFIX."""
    found: dict[str, StaticFile] = {}
    for prefix, folder in FOLDERS.items():
        for path in folder.rglob("*"):
            if path.suffix in MEDIA_TYPES:
                body = path.read_bytes()
                etag = f'"{hashlib.sha256(body).hexdigest()[:32]}"'
                name = prefix + path.relative_to(folder).as_posix()
                scripts = " ".join(map(_source, INLINE_SCRIPT.findall(body))) if path.suffix == ".html" else ""
                found[name] = StaticFile(body, MEDIA_TYPES[path.suffix], etag, scripts)
    return found


def _source(script: bytes) -> str:
    """Return the hash by which a content security policy allows an inline script."""
    return f"'sha256-{b64encode(hashlib.sha256(script).digest()).decode()}'"


class Dashboard:
    """Files of the dashboard, whose pages may connect to this Master, Robot endpoints and services only."""

    def __init__(self, state: State) -> None:
        self._state = state
        self._files = load_files()

    def handle(self, request: web.BaseRequest) -> web.Response:
        """Answer a request for a path below PREFIX."""
        if request.method not in ("GET", "HEAD"):
            response = text_response(405, "the dashboard is only read: use GET")
            response.headers["Allow"] = "GET, HEAD"
            return response
        name = raw_path(request).removeprefix(PREFIX) or "index.html"
        file = self._files.get(name)
        if file is None:
            return text_response(404, f"the dashboard has no {name[:200]}".encode("ascii", "replace").decode())
        policy = CONTENT_SECURITY_POLICY.format(
            scripts=file.scripts,
            sources=self._connect_sources(request),
            styles=" 'unsafe-inline'" if name in INLINE_STYLES else "",
        )
        headers = {
            "Content-Type": file.media_type,
            "Content-Security-Policy": policy,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cache-Control": "no-cache",  # the browser keeps it, and asks each time whether it has changed
            "ETag": file.etag,
        }
        known = {
            tag for value in request.headers.getall("If-None-Match", []) for tag in value.replace(",", " ").split()
        }
        if known & {file.etag, "*"}:
            return web.Response(status=304, headers=headers)
        return web.Response(body=file.body, headers=headers)

    def _connect_sources(self, request: web.BaseRequest) -> str:
        """Return the addresses that pages may connect to: not every browser applies 'self' to WebSockets too."""
        sources = ["'self'"]
        host = header(request, "Host") or ""
        if HOST.fullmatch(host):  # otherwise it could add directives to the policy
            sources.append(f"{'wss' if request.secure else 'ws'}://{host}")
            name = host_name(request)
            found = [*self._state.processes.by("robot"), *self._state.processes.by("service")]
            sources += (absolute_url(each.url, name).rstrip("/") for each in found)
        return " ".join(dict.fromkeys(sources))


def wants_dashboard(request: web.BaseRequest) -> bool:
    """Return whether a person opens the bare entry in a browser; robots are answered as the original does."""
    parameters = query_parameters(raw_query(request))
    html = "text/html" in (header(request, "Accept") or "")
    return raw_path(request) == "/" and html and "userID" not in parameters and "version" not in parameters
