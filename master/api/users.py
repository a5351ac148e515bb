"""`/api/v1/whoami` and `/api/v1/users`: users with their roles, passwords, limits and usage."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta

from master.access.passwords import check_password
from master.access.rights import EVERYBODY, RIGHTS, reach
from master.access.users import digest
from master.api.principals import authorize, authorize_list, authorize_platform, page_of_views, principal_of
from master.api.request import Answer, Call, PageQuery
from master.api.router import Api, Route
from master.graph import limits as policies
from master.graph.limits import Policy
from master.service import Master
from rce.api.views import NewPassword, NewUser, Page, UsageView, UserChanges, UserView, Whoami
from rce.errors import Forbidden, Unauthorized
from rce.web.requests import peer_address

USER = "/users/{name}"


LimitChanges = Annotated[
    dict[str, Any], Meta(extra_json_schema={"propertyNames": {"enum": [*Policy.__struct_fields__]}})
]


class UsersApi:
    """Routes of users, and of the caller's identity."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._users = master.users

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        api.add(
            Route("GET", "/whoami", self._whoami, "User, role and rights of the credentials", answer=Whoami),
            Route("GET", "/users", self._list, "Users", PageQuery, answer=Page[UserView]),
            Route("POST", "/users", self._add, "Create a user", body=NewUser, answer=UserView, status=201),
            Route("GET", USER, self._show, "A user", answer=UserView),
            Route("PATCH", USER, self._change, "Change a user's role", body=UserChanges, answer=UserView),
            Route("DELETE", USER, self._remove, "Remove a user and everything that the user owns", status=204),
            Route("PUT", USER + "/password", self._change_password, "Change a password", body=NewPassword, status=204),
            Route("GET", USER + "/limits", self._show_limits, "Limits of a user", answer=Policy),
            Route(
                *(
                    "PATCH",
                    USER + "/limits",
                    self._change_limits,
                    "Change limits: a number, an amount such as 2GiB, null for no limit, an empty text for the default",
                ),
                body=LimitChanges,
                answer=Policy,
            ),
            Route(
                "GET",
                USER + "/usage",
                self._show_usage,
                "Usage of a user, in the units of the limits",
                answer=UsageView,
            ),
        )

    async def _whoami(self, call: Call) -> Answer:
        principal = principal_of(call)
        authorize(call, "whoami", "")
        rights = {operation: reach(principal, operation) for operation in RIGHTS}
        return Answer(Whoami(principal.user, principal.role, principal.key, principal.scopes, rights))

    async def _list(self, call: Call) -> Answer:
        query = call.query(PageQuery)
        owner = authorize_list(call, "user.read", EVERYBODY)
        found = [each for each in await self._users.all() if owner in (EVERYBODY, each.name)]
        return page_of_views(((each.name, each) for each in found), query)

    async def _show(self, call: Call) -> Answer:
        return Answer(await self._users.get(authorize(call, "user.read", call.path["name"])))

    async def _add(self, call: Call) -> Answer:
        authorize_platform(call, "user.create")
        wanted = call.body(NewUser)
        check_password(wanted.password, wanted.name)
        return Answer(await self._users.add(wanted.name, wanted.password, wanted.role), 201)

    async def _change(self, call: Call) -> Answer:
        name = authorize(call, "user.change", call.path["name"])
        await self._master.guard.change_role(name, call.body(UserChanges).role)
        return Answer(await self._users.get(name))

    async def _remove(self, call: Call) -> Answer:
        await self._master.guard.remove_user(authorize(call, "user.remove", call.path["name"]))
        return Answer(status=204)

    async def _change_password(self, call: Call) -> Answer:
        name = authorize(call, "password.change", call.path["name"])
        wanted = call.body(NewPassword)
        if name == call.user:
            try:
                await self._users.check_password(name, digest(wanted.old), peer_address(call.request))
            except Unauthorized:
                raise Forbidden("the old password is wrong", field="old") from None
        check_password(wanted.new, name)
        await self._master.guard.change_password(name, wanted.new)
        return Answer(status=204)

    async def _show_limits(self, call: Call) -> Answer:
        return self._answer_limits(await self._existing(authorize(call, "limits.read", call.path["name"])))

    async def _change_limits(self, call: Call) -> Answer:
        name = await self._existing(authorize(call, "limits.change", call.path["name"]))
        await self._master.limits.change(name, policies.changes(call.body(dict[str, Any])))
        return self._answer_limits(name)

    def _answer_limits(self, name: str) -> Answer:
        return Answer(self._master.limits.of(name))

    async def _show_usage(self, call: Call) -> Answer:
        name = await self._existing(authorize(call, "usage.read", call.path["name"]))
        return Answer(policies.usage(self._master.state, name))

    async def _existing(self, name: str) -> str:
        """Return the name of a user.

        Raises:
            NotFound: There is no such user.
        """
        return (await self._users.get(name)).name
