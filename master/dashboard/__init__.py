"""The dashboard at `/ui/`: the files of `web/`, as they are, and those of the JavaScript client below `/ui/rce/`."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import NamedTuple

from twisted.web import http
from twisted.web.resource import Resource
from twisted.web.server import Request

import rce
from master.entry import absolute
from master.records import State

PREFIX = b"/ui/"
HOST = re.compile(r"[A-Za-z0-9.:\[\]-]+", re.ASCII)
KINDS = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".ts": "text/plain; charset=utf-8",
}
FOLDERS = {"": Path(__file__).parent / "web", "rce/": Path(rce.__file__).parent / "js"}
POLICY = (
    "default-src 'self'; connect-src {places}; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; "
    "object-src 'none'"
)


class _File(NamedTuple):
    body: bytes
    kind: str
    tag: str


def files() -> dict[str, _File]:
    """What is served, by its path below PREFIX."""
    found: dict[str, _File] = {}
    for prefix, folder in FOLDERS.items():
        for path in folder.rglob("*"):
            if path.suffix in KINDS:
                body = path.read_bytes()
                tag = f'"{hashlib.sha256(body).hexdigest()[:32]}"'
                found[prefix + path.relative_to(folder).as_posix()] = _File(body, KINDS[path.suffix], tag)
    return found


class Dashboard(Resource):
    """Pages may speak to the Master that they came from and to the Robot endpoints of `state`, and to nobody else."""

    isLeaf = True

    def __init__(self, state: State) -> None:
        super().__init__()  # type: ignore[no-untyped-call]  # Twisted's
        self._state = state
        self._files = files()

    def render_GET(self, request: Request) -> bytes:
        name = request.path.removeprefix(PREFIX).decode("ascii", "replace") or "index.html"
        file = self._files.get(name)
        if file is None:
            request.setResponseCode(http.NOT_FOUND)
            request.setHeader("content-type", "text/plain; charset=utf-8")
            return f"the dashboard has no {name[:200]}\n".encode()
        request.setHeader("content-type", file.kind)
        request.setHeader("content-security-policy", POLICY.format(places=self._places(request)))
        request.setHeader("x-content-type-options", "nosniff")
        request.setHeader("referrer-policy", "no-referrer")
        request.setHeader("cache-control", "no-cache")  # the browser keeps it and asks whether it is still the same
        if request.setETag(file.tag.encode()) is http.CACHED:
            return b""
        return file.body

    def _places(self, request: Request) -> str:
        """Not every browser takes 'self' for WebSockets too."""
        places = ["'self'"]
        host = request.getHeader("host") or ""
        if HOST.fullmatch(host):  # else it could say more than a host to the policy
            places.append(f"{'wss' if request.isSecure() else 'ws'}://{host}")
            name = request.getRequestHostname()
            places += (absolute(each.url, name).rstrip("/") for each in self._state.processes.by("robot"))
        return " ".join(dict.fromkeys(places))


def wants_dashboard(request: Request) -> bool:
    """Whether a person looks at the bare entry with a browser; to robots it answers as the original does."""
    asked = request.args or {}
    html = "text/html" in (request.getHeader("accept") or "")
    return request.path == b"/" and html and b"userID" not in asked and b"version" not in asked
