"""The site at the entry: API and dashboard under their prefixes, else robots; archives go straight to disk."""

from __future__ import annotations

from typing import Any

from twisted.web.resource import Resource
from twisted.web.server import Request
from twisted.web.util import Redirect

from master import dashboard
from master.api.door import authorization
from master.api.router import PREFIX
from master.depot import Depot
from master.entry import Entry
from master.redirect import EntryRequest, EntrySite

BESIDE = (b"healthz", b"readyz", b"metrics")


class ApiRequest(EntryRequest):
    """A request whose body goes to the depot if it is an upload that was announced."""

    def gotLength(self, length: int | None) -> None:
        channel: Any = self.channel
        depot: Depot = channel.site.depot
        kind, token = authorization(self)
        upload = depot.begin(token, length) if kind == "bearer" else None
        if upload is None:
            super().gotLength(length)
        else:
            self.content = upload


class ApiSite(EntrySite):
    """`entry` answers everything that is neither the API's nor the dashboard's."""

    requestFactory = ApiRequest

    def __init__(self, entry: Entry, api: Resource, depot: Depot) -> None:
        super().__init__(entry)
        self.depot = depot
        self.resource = _Root(entry, api)


class _Root(Resource):
    def __init__(self, entry: Entry, api: Resource) -> None:
        super().__init__()  # type: ignore[no-untyped-call]  # Twisted's
        self._entry = entry
        self._api = api
        self._dashboard = dashboard.Dashboard(entry.state)

    def getChild(self, path: bytes, request: Request) -> Resource:
        if request.path.startswith(PREFIX.encode() + b"/") or request.path.split(b"/")[1] in BESIDE:
            return self._api
        if request.path.startswith(dashboard.PREFIX):
            return self._dashboard
        if request.path == dashboard.PREFIX.rstrip(b"/") or dashboard.wants_dashboard(request):
            return Redirect(dashboard.PREFIX)
        return self._entry
