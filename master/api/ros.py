"""`/api/v1/environments/{environment}/topics` and `…/services`: the ROS graph that the environment sees."""

from __future__ import annotations

from master.api.principals import find_environment, page_of_views
from master.api.request import Answer, Call, Owner, PageQuery
from master.api.router import Api, Route
from master.service import Master
from rce.api.views import Page
from rce.control.calls.watching import ReadGraph, RosGraph, RosName

AT = "/environments/{environment}"


class RosQuery(PageQuery, frozen=True, forbid_unknown_fields=True):
    """Query of a list of names."""

    user: Owner = ""


class RosApi:
    """Routes of ROS topics and services: their names and types, to choose the topic of an interface by."""

    def __init__(self, master: Master) -> None:
        self._master = master

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        api.add(
            Route("GET", AT + "/topics", self._list_topics, "Its ROS topics", RosQuery, answer=Page[RosName]),
            Route("GET", AT + "/services", self._list_services, "Its ROS services", RosQuery, answer=Page[RosName]),
        )

    async def _list_topics(self, call: Call) -> Answer:
        return page_of_views(((each.name, each) for each in (await self._graph(call)).topics), call.query(RosQuery))

    async def _list_services(self, call: Call) -> Answer:
        return page_of_views(((each.name, each) for each in (await self._graph(call)).services), call.query(RosQuery))

    async def _graph(self, call: Call) -> RosGraph:
        environment = find_environment(call, self._master.state, "interface.read", call.query(RosQuery).user)
        return await self._master.ask(environment, ReadGraph())
