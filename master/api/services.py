"""`/api/v1/services`: addresses of the services that have joined, for pages and programs that talk to them directly."""

from __future__ import annotations

from master.api.principals import authorize, page_of_views
from master.api.request import Answer, Call, PageQuery
from master.api.router import Api, Route
from master.redirect import absolute_url
from master.service import Master
from rce.api.views import Page, ServiceView
from rce.web.requests import host_name


class ServicesApi:
    """Route of services."""

    def __init__(self, master: Master) -> None:
        self._state = master.state

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        api.add(
            Route("GET", "/services", self._list, "Services and their addresses", PageQuery, answer=Page[ServiceView])
        )

    async def _list(self, call: Call) -> Answer:
        authorize(call, "job.read", "")
        host = host_name(call.request)
        joined = sorted(each.name for each in self._state.processes.by("service") if each.name in self._state.joined)
        views = [
            ServiceView(name, f"{absolute_url(self._state.processes[name].url, host).rstrip('/')}/{name}")
            for name in joined
        ]
        return page_of_views(((view.name, view) for view in views), call.query(PageQuery))
