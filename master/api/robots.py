"""`/api/v1/robots`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from master import rights
from master.api.acting import acting, listing, page, principal
from master.api.calls import Answer, Call, Listing, One
from master.api.router import Api, Route
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
        )

    async def list(self, call: Call) -> Answer:
        asked = call.asked(Robots)
        user = listing(call, "robot.read", asked.user)

        def keep(each: RobotView) -> bool:
            seen = rights.may(principal(call), "robot.read", each.user, robot=each.robotID)
            return seen and asked.endpoint in ("", each.endpoint)

        return page(self._master.state.robots, user, asked, self._master.shown.robot, keep)

    async def show(self, call: Call) -> Answer:
        user = acting(call, "robot.read", call.asked(One).user, robot=call.path["robot"])
        robot = self._master.state.robots.get(f"{user}/{call.path['robot']}")
        if robot is None:
            raise NotFound(f"there is no robot {call.path['robot'][:80]!r}", field="robot")
        return Answer(self._master.shown.robot(robot))
