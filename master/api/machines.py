"""`/api/v1/machines` and `/api/v1/groups`."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from master import rights
from master.api.acting import acting, cut, listing, platform
from master.api.calls import Answer, Call, Listing, One, Paging
from master.api.router import Api, Route
from master.machines import Inviter
from master.records import user_of
from master.service import Master
from rce.errors import NotFound
from rce.views import GroupView, Invited, MachineView, NewInvitation, Page

ROLES = ("container", "robot", "service")


class Machines(Paging, frozen=True, forbid_unknown_fields=True):
    """Which machines."""

    role: Annotated[Literal["container", "robot", "service"] | None, Meta(description="those with this role")] = None
    state: Literal["joined", "away", "gone"] | None = None


class MachinesApi:
    """The platform's own processes, and network groups."""

    def __init__(self, master: Master, inviter: Inviter | None) -> None:
        self._master = master
        self._state = master.state
        self._inviter = inviter

    def add_to(self, api: Api) -> None:
        api.add(
            Route(
                "GET", "/machines", self.list, "Task sets, Robot endpoints, services", Machines, None, Page[MachineView]
            ),
            Route("GET", "/machines/{name}", self.show, "One of them", answer=MachineView),
            Route(
                *("POST", "/machines/invitations", self.invite, "A join code for a machine"),
                *(None, NewInvitation, Invited, 201),
            ),
            Route("GET", "/groups", self.groups, "Network groups", Listing, answer=Page[GroupView]),
            Route("GET", "/groups/{group}", self.group, "A network group", One, answer=GroupView),
        )

    async def list(self, call: Call) -> Answer:
        asked = call.asked(Machines)
        platform(call, "machine.read")
        machines = [process for role in ROLES for process in self._state.processes.by(role)]
        views = ((each.name, self._master.shown.process(each)) for each in machines)
        return cut(views, asked, lambda each: asked.role in (None, each.role) and asked.state in (None, each.state))

    async def show(self, call: Call) -> Answer:
        platform(call, "machine.read")
        machine = self._state.processes.get(call.path["name"])
        if machine is None or machine.role not in ROLES:
            raise NotFound(f"there is no machine {call.path['name'][:80]!r}", field="name")
        return Answer(self._master.shown.process(machine))

    async def invite(self, call: Call) -> Answer:
        platform(call, "machine.invite")
        wanted = call.body(NewInvitation)
        if self._inviter is None:
            raise NotFound("this Master takes no machines in: it lacks the settings machines and tls")
        code = await self._inviter.code(wanted.name, wanted.roles, wanted.address, wanted.hours)
        return Answer(Invited(wanted.name, code.text(), code.invitation.expires), 201)

    async def groups(self, call: Call) -> Answer:
        asked = call.asked(Listing)
        user = listing(call, "group.read", asked.user)
        users = {user_of(each.name) for each in self._state.environments} if user == rights.EVERYBODY else {user}
        return cut(
            ((f"{each.user}/{each.group}", each) for one in users for each in self._master.shown.groups(one)), asked
        )

    async def group(self, call: Call) -> Answer:
        user = acting(call, "group.read", call.asked(One).user)
        for each in self._master.shown.groups(user):
            if each.group == call.path["group"]:
                return Answer(each)
        raise NotFound(f"there is no network group {call.path['group'][:80]!r}", field="group")
