"""Redirects to services: a path that begins with the name of one (`/map-service/…`) belongs to that service."""

from __future__ import annotations

from aiohttp import web

from master.graph.state import State
from rce.errors import Unavailable
from rce.web.requests import host_name, raw_path


class ServiceRedirects:
    """Addresses of the services that have joined the platform."""

    def __init__(self, state: State) -> None:
        self._state = state

    def location(self, request: web.BaseRequest) -> str:
        """Return the address of this resource at the service that its path names; empty if it names none.

        Raises:
            Unavailable: The service is away.
        """
        name = raw_path(request).lstrip("/").partition("/")[0]
        service = self._state.processes.get(name)
        if service is None or service.role != "service":
            return ""
        if name not in self._state.joined:
            raise Unavailable(f"the service {name} is away at present; try again in a moment")
        return absolute_url(service.url, host_name(request)).rstrip("/") + "/" + request.raw_path.lstrip("/")


def absolute_url(url: str, host: str) -> str:
    """Return the address of a process; one without a host is on the host that the client's request names."""
    scheme, _, rest = url.partition("://")
    if rest.startswith(":"):
        rest = (f"[{host}]" if ":" in host else host) + rest
    return f"{scheme}://{rest}"
