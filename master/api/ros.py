"""`/api/v1/environments/{environment}/topics`, `services`, `actions`, `types`, `packages`: ROS as it sees it."""

from __future__ import annotations

from msgspec import Struct

from master.api.principals import find_environment, page_of_views
from master.api.request import Answer, Call, Owner, PageQuery
from master.api.router import Api, Route
from master.graph.records import Environment, user_of
from master.service import Master
from rce.api.views import Page
from rce.control.calls.robots import Definitions, DescribeType, Sort
from rce.control.calls.watching import ReadGraph, ReadPackages, RosAction, RosGraph, RosName, RosPackage
from rce.errors import InvalidRequest
from rce.protocol.names import TYPE, TypeText

AT = "/environments/{environment}"


class RosQuery(PageQuery, frozen=True, forbid_unknown_fields=True):
    """Query of a list of names."""

    user: Owner = ""


class TypeQuery(Struct, frozen=True, forbid_unknown_fields=True):
    """Query of a definition: a type such as `std_msgs/String`, and what sort it is."""

    type: TypeText
    sort: Sort = "msg"
    user: Owner = ""


class RosApi:
    """Routes of ROS names and types, to choose the topic of an interface by, and of executables, to start nodes."""

    def __init__(self, master: Master) -> None:
        self._master = master

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        api.add(
            Route("GET", AT + "/topics", self._list_topics, "Its ROS topics", RosQuery, answer=Page[RosName]),
            Route("GET", AT + "/services", self._list_services, "Its ROS services", RosQuery, answer=Page[RosName]),
            Route("GET", AT + "/actions", self._list_actions, "Its ROS actions", RosQuery, answer=Page[RosAction]),
            Route(
                "GET",
                AT + "/packages",
                self._list_packages,
                "Its ROS packages with executables",
                RosQuery,
                answer=Page[RosPackage],
            ),
            Route(
                "GET",
                AT + "/types",
                self._describe,
                "Definition of a ROS type that it knows",
                TypeQuery,
                answer=Definitions,
            ),
        )

    async def _list_topics(self, call: Call) -> Answer:
        return page_of_views(((each.name, each) for each in (await self._graph(call)).topics), call.query(RosQuery))

    async def _list_services(self, call: Call) -> Answer:
        return page_of_views(((each.name, each) for each in (await self._graph(call)).services), call.query(RosQuery))

    async def _list_actions(self, call: Call) -> Answer:
        return page_of_views(((each.name, each) for each in (await self._graph(call)).actions), call.query(RosQuery))

    async def _list_packages(self, call: Call) -> Answer:
        found = await self._master.ask(self._environment(call), ReadPackages())
        return page_of_views(((each.name, each) for each in found.packages), call.query(RosQuery))

    async def _describe(self, call: Call) -> Answer:
        query = call.query(TypeQuery)
        if not TYPE.fullmatch(query.type):
            raise InvalidRequest(f"{query.type[:80]!r} is not a ROS type: write it as pkg/Name", field="type")
        environment = find_environment(call, self._master.state, "interface.read", query.user)
        described = await self._master.ask(environment, DescribeType(user_of(environment.name), query.type, query.sort))
        return Answer(described)

    async def _graph(self, call: Call) -> RosGraph:
        return await self._master.ask(self._environment(call), ReadGraph())

    def _environment(self, call: Call) -> Environment:
        return find_environment(call, self._master.state, "interface.read", call.query(RosQuery).user)
