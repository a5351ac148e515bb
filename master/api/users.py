"""`/api/v1/whoami` and `/api/v1/users`: who there is, their roles, passwords, limits and what they have of these."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta

from master import policies
from master.api.acting import acting, cut, listing, platform, principal
from master.api.calls import Answer, Call, Paging
from master.api.door import host_of
from master.api.router import Api, Route
from master.passwords import check_password
from master.policies import Policy
from master.rights import EVERYBODY, RIGHTS, reach
from master.service import Master
from master.users import digest
from rce.errors import Forbidden, Unauthorized
from rce.views import NewPassword, NewUser, Page, UsageView, UserChanges, UserView, Whoami

ONE = "/users/{name}"


Limits = Annotated[dict[str, Any], Meta(extra_json_schema={"propertyNames": {"enum": [*Policy.__struct_fields__]}})]


class UsersApi:
    """Users, and who is asking."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._users = master.users

    def add_to(self, api: Api) -> None:
        api.add(
            Route("GET", "/whoami", self.whoami, "Who the credentials are", answer=Whoami),
            Route("GET", "/users", self.list, "Users", Paging, answer=Page[UserView]),
            Route("POST", "/users", self.add, "Make a user", body=NewUser, answer=UserView, status=201),
            Route("GET", ONE, self.show, "A user", answer=UserView),
            Route("PATCH", ONE, self.change, "Change a user's role", body=UserChanges, answer=UserView),
            Route("DELETE", ONE, self.remove, "Remove a user with all that is theirs", status=204),
            Route("PUT", ONE + "/password", self.password, "Change a password", body=NewPassword, status=204),
            Route("GET", ONE + "/limits", self.limits, "What a user may have", answer=Policy),
            Route(
                *("PATCH", ONE + "/limits", self.limit, "Change some limits: numbers or amounts as 2GiB, null to undo"),
                body=Limits,
                answer=Policy,
            ),
            Route("GET", ONE + "/usage", self.usage, "What a user has of that which limits count", answer=UsageView),
        )

    async def whoami(self, call: Call) -> Answer:
        who = principal(call)
        acting(call, "whoami", "")
        rights = {operation: reach(who, operation) for operation in RIGHTS}
        return Answer(Whoami(who.user, who.role, who.key, who.scopes, rights))

    async def list(self, call: Call) -> Answer:
        asked = call.asked(Paging)
        whose = listing(call, "user.read", EVERYBODY)
        found = [each for each in await self._users.all() if whose in (EVERYBODY, each.name)]
        return cut(((each.name, each) for each in found), asked)

    async def show(self, call: Call) -> Answer:
        return Answer(await self._users.get(acting(call, "user.read", call.path["name"])))

    async def add(self, call: Call) -> Answer:
        platform(call, "user.create")
        wanted = call.body(NewUser)
        check_password(wanted.password, wanted.name)
        return Answer(await self._users.add(wanted.name, wanted.password, wanted.role), 201)

    async def change(self, call: Call) -> Answer:
        name = acting(call, "user.change", call.path["name"])
        await self._master.guard.change_role(name, call.body(UserChanges).role)
        return Answer(await self._users.get(name))

    async def remove(self, call: Call) -> Answer:
        await self._master.guard.remove_user(acting(call, "user.remove", call.path["name"]))
        return Answer(status=204)

    async def password(self, call: Call) -> Answer:
        name = acting(call, "password.change", call.path["name"])
        wanted = call.body(NewPassword)
        if name == call.user:
            try:
                await self._users.check_password(name, digest(wanted.old), host_of(call.request))
            except Unauthorized:
                raise Forbidden("the old password is wrong", field="old") from None
        check_password(wanted.new, name)
        await self._master.guard.change_password(name, wanted.new)
        return Answer(status=204)

    async def limits(self, call: Call) -> Answer:
        return self._limits(await self._known(acting(call, "limits.read", call.path["name"])))

    async def limit(self, call: Call) -> Answer:
        name = await self._known(acting(call, "limits.change", call.path["name"]))
        await self._master.limits.change(name, policies.changes(call.body(dict[str, Any])))
        return self._limits(name)

    def _limits(self, name: str) -> Answer:
        return Answer(self._master.limits.of(name))

    async def usage(self, call: Call) -> Answer:
        name = await self._known(acting(call, "usage.read", call.path["name"]))
        return Answer(policies.usage(self._master.state, name))

    async def _known(self, name: str) -> str:
        """NotFound."""
        return (await self._users.get(name)).name
