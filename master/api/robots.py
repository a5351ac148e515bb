"""`/api/v1/robots`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from master import rights
from master.api.acting import acting, listing, page, principal
from master.api.calls import Answer, Call, Listing, One
from master.api.router import Api, Route
from master.records import Robot
from master.service import Master
from rce.errors import NotFound
from rce.views import Page, RobotView


class Robots(Listing, frozen=True, forbid_unknown_fields=True):
    """Which robots."""

    endpoint: Annotated[str, Meta(max_length=600, description="those at this Robot endpoint")] = ""


class RobotsApi:
    """Robots that have a session."""

    def __init__(self, master: Master) -> None:
        self._master = master

    def add_to(self, api: Api) -> None:
        api.add(
            Route("GET", "/robots", self.list, "Robots that have a session", Robots, answer=Page[RobotView]),
            Route("GET", "/robots/{robot}", self.show, "A robot", One, answer=RobotView),
            Route(
                "DELETE", "/robots/{robot}", self.disconnect, "End its session and close its socket", One, status=204
            ),
        )

    async def list(self, call: Call) -> Answer:
        asked = call.asked(Robots)
        user = listing(call, "robot.read", asked.user)

        def keep(each: RobotView) -> bool:
            seen = rights.may(principal(call), "robot.read", each.user, robot=each.robotID)
            return seen and asked.endpoint in ("", each.endpoint)

        return page(self._master.state.robots, user, asked, self._master.shown.robot, keep)

    async def show(self, call: Call) -> Answer:
        return Answer(self._master.shown.robot(self._robot(call, "robot.read")))

    async def disconnect(self, call: Call) -> Answer:
        robot = self._robot(call, "robot.disconnect")
        await self._master.sessions.disconnect(robot.name, f"disconnected by {call.user}")
        return Answer(status=204)

    def _robot(self, call: Call, operation: str) -> Robot:
        tag = call.path["robot"]
        robot = self._master.state.robots.get(f"{acting(call, operation, call.asked(One).user, robot=tag)}/{tag}")
        if robot is None:
            raise NotFound(f"there is no robot {tag[:80]!r}", field="robotID")
        return robot
