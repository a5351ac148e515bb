"""`/api/v1/machines` and `/api/v1/groups`."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from master.access import rights
from master.access.enrolment import Inviter
from master.api.principals import authorize, authorize_list, authorize_platform, page_of_views, principal_of
from master.api.request import Answer, Call, ListQuery, OwnerQuery, PageQuery
from master.api.router import Api, Route
from master.graph.records import user_of
from master.service import Master
from rce.api.views import GroupView, Invited, MachineView, NewInvitation, Page
from rce.errors import NotFound

ROLES = ("container", "robot", "service")


class MachinesQuery(PageQuery, frozen=True, forbid_unknown_fields=True):
    """Filters of machines."""

    role: Annotated[Literal["container", "robot", "service"] | None, Meta(description="with this role")] = None
    state: Literal["joined", "away", "gone"] | None = None


class MachinesApi:
    """Routes of the platform's own processes, and of network groups."""

    def __init__(self, master: Master, inviter: Inviter | None) -> None:
        self._master = master
        self._state = master.state
        self._inviter = inviter

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        api.add(
            Route(
                "GET",
                "/machines",
                self._list,
                "Task sets, Robot endpoints, services",
                MachinesQuery,
                None,
                Page[MachineView],
            ),
            Route("GET", "/machines/{name}", self._show, "A task set, Robot endpoint or service", answer=MachineView),
            Route("DELETE", "/machines/{name}", self._remove, "Disconnect a machine for good", status=204),
            Route(
                *("POST", "/machines/invitations", self._invite, "Create a join code for a machine"),
                *(None, NewInvitation, Invited, 201),
            ),
            Route("GET", "/groups", self._list_groups, "Network groups", ListQuery, answer=Page[GroupView]),
            Route("GET", "/groups/{group}", self._show_group, "A network group", OwnerQuery, answer=GroupView),
        )

    async def _list(self, call: Call) -> Answer:
        query = call.query(MachinesQuery)
        authorize_platform(call, "machine.read")
        machines = [process for role in ROLES for process in self._state.processes.by(role)]
        views = ((each.name, self._master.presenter.process(each)) for each in machines)
        return page_of_views(
            views, query, lambda each: query.role in (None, each.role) and query.state in (None, each.state)
        )

    async def _show(self, call: Call) -> Answer:
        authorize_platform(call, "machine.read")
        machine = self._state.processes.get(call.path["name"])
        if machine is None or machine.role not in ROLES:
            raise NotFound(f"there is no machine {call.path['name'][:80]!r}", field="name")
        return Answer(self._master.presenter.process(machine))

    async def _remove(self, call: Call) -> Answer:
        authorize_platform(call, "machine.remove")
        await self._master.removals.remove(call.path["name"])
        return Answer(status=204)

    async def _invite(self, call: Call) -> Answer:
        authorize_platform(call, "machine.invite")
        wanted = call.body(NewInvitation)
        if self._inviter is None:
            raise NotFound("machines cannot join this Master: it lacks the settings machines and tls")
        principal = principal_of(call)
        by = await self._master.users.keys.get(principal.user, principal.key) if principal.key else None
        code = await self._inviter.code(wanted.name, wanted.roles, wanted.address, wanted.hours, by)
        return Answer(Invited(wanted.name, code.text(), code.invitation.expires), 201)

    async def _list_groups(self, call: Call) -> Answer:
        query = call.query(ListQuery)
        user = authorize_list(call, "group.read", query.user)
        users = {user_of(each.name) for each in self._state.environments} if user == rights.EVERYBODY else {user}
        return page_of_views(
            ((f"{each.user}/{each.group}", each) for name in users for each in self._master.presenter.groups(name)),
            query,
        )

    async def _show_group(self, call: Call) -> Answer:
        user = authorize(call, "group.read", call.query(OwnerQuery).user)
        for each in self._master.presenter.groups(user):
            if each.group == call.path["group"]:
                return Answer(each)
        raise NotFound(f"there is no network group {call.path['group'][:80]!r}", field="group")
