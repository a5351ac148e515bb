"""`/api/v1/robots`: robots that have a session."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from master.access import rights
from master.api.principals import authorize, authorize_list, page_of_records, principal_of
from master.api.request import Answer, Call, ListQuery, OwnerQuery
from master.api.router import Api, Route
from master.graph.records import Robot
from master.service import Master
from rce.api.views import Page, RobotView
from rce.errors import NotFound
from rce.spelling import tags, unknown


class RobotsQuery(ListQuery, frozen=True, forbid_unknown_fields=True):
    """Filters of robots."""

    endpoint: Annotated[str, Meta(max_length=600, description="at this Robot endpoint")] = ""


class RobotsApi:
    """Routes of robots."""

    def __init__(self, master: Master) -> None:
        self._master = master

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        api.add(
            Route("GET", "/robots", self._list, "Robots that have a session", RobotsQuery, answer=Page[RobotView]),
            Route("GET", "/robots/{robot}", self._show, "A robot", OwnerQuery, answer=RobotView),
            Route(
                "DELETE",
                "/robots/{robot}",
                self._disconnect,
                "End the session of a robot and close its socket",
                OwnerQuery,
                status=204,
            ),
        )

    async def _list(self, call: Call) -> Answer:
        query = call.query(RobotsQuery)
        user = authorize_list(call, "robot.read", query.user)

        def keep(each: RobotView) -> bool:
            seen = rights.may(principal_of(call), "robot.read", each.user, robot=each.robotID)
            return seen and query.endpoint in ("", each.endpoint)

        return page_of_records(self._master.state.robots, user, query, self._master.presenter.robot, keep)

    async def _show(self, call: Call) -> Answer:
        return Answer(self._master.presenter.robot(self._find(call, "robot.read")))

    async def _disconnect(self, call: Call) -> Answer:
        robot = self._find(call, "robot.disconnect")
        await self._master.sessions.disconnect(robot.name, f"disconnected by {call.user}")
        return Answer(status=204)

    def _find(self, call: Call, operation: str) -> Robot:
        tag = call.path["robot"]
        owner, robots = authorize(call, operation, call.query(OwnerQuery).user, robot=tag), self._master.state.robots
        robot = robots.get(f"{owner}/{tag}")
        if robot is None:
            raise NotFound(unknown("robot", tag, tags(each.name for each in robots.by(owner))), field="robotID")
        return robot
