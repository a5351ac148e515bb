"""`/api/v1/environments/{environment}/topics` and `…/services`: what ROS has there, asked of the environment itself."""

from __future__ import annotations

from master.api.acting import acting, cut
from master.api.calls import Answer, Call, Paging, Whose
from master.api.router import Api, Route
from master.service import Master
from rce.calls.watching import ReadGraph, RosGraph, RosName
from rce.errors import NotFound
from rce.views import Page

AT = "/environments/{environment}"


class RosNames(Paging, frozen=True, forbid_unknown_fields=True):
    """A part of the names."""

    user: Whose = ""


class RosApi:
    """Names and types of topics and services, by which the topic of an interface is found."""

    def __init__(self, master: Master) -> None:
        self._master = master

    def add_to(self, api: Api) -> None:
        api.add(
            Route("GET", AT + "/topics", self.topics, "Its ROS topics", RosNames, answer=Page[RosName]),
            Route("GET", AT + "/services", self.services, "Its ROS services", RosNames, answer=Page[RosName]),
        )

    async def topics(self, call: Call) -> Answer:
        return cut(((each.name, each) for each in (await self._graph(call)).topics), call.asked(RosNames))

    async def services(self, call: Call) -> Answer:
        return cut(((each.name, each) for each in (await self._graph(call)).services), call.asked(RosNames))

    async def _graph(self, call: Call) -> RosGraph:
        tag = call.path["environment"]
        user = acting(call, "interface.read", call.asked(RosNames).user, environment=tag)
        environment = self._master.state.environments.get(f"{user}/{tag}")
        if environment is None:
            raise NotFound(f"there is no environment {tag[:80]!r}", field="environment")
        return await self._master.ask(environment, ReadGraph())
