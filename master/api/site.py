"""The site at the Master's entry: the API under its prefix, else the robots' entry; archives go straight to disk."""

from __future__ import annotations

from typing import Any

from twisted.web.resource import Resource
from twisted.web.server import Request

from master.api.router import PREFIX, authorization
from master.depot import Depot
from master.entry import Entry
from master.redirect import EntryRequest, EntrySite


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
    """`entry` answers everything that is not the API's."""

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

    def getChild(self, path: bytes, request: Request) -> Resource:
        return self._api if request.path.startswith(PREFIX.encode() + b"/") else self._entry
