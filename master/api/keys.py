"""`/api/v1/keys`: API keys are made, shown once, rotated and revoked."""

from __future__ import annotations

import time

from master.api.acting import acting, cut, listing, principal
from master.api.calls import Answer, Call, Listing, One
from master.api.router import Api, Route
from master.rights import EVERYBODY
from master.service import Master
from rce.errors import Forbidden, InvalidRequest
from rce.roles import WITHIN, UserRole
from rce.views import KeyView, MadeKey, NewKey, Page

ONE = "/keys/{key}"


class KeysApi:
    """API keys of users."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._keys = master.users.keys

    def add_to(self, api: Api) -> None:
        api.add(
            Route("GET", "/keys", self.list, "API keys", Listing, answer=Page[KeyView]),
            Route("POST", "/keys", self.add, "Make an API key", One, NewKey, MadeKey, 201),
            Route("GET", ONE, self.show, "An API key", One, answer=KeyView),
            Route("DELETE", ONE, self.revoke, "Revoke it: what is open by it is closed", One, status=204),
            Route("POST", ONE + "/rotate", self.rotate, "Give it a new secret: the old is void", One, answer=MadeKey),
        )

    async def list(self, call: Call) -> Answer:
        asked = call.asked(Listing)
        whose = listing(call, "key.read", asked.user)
        found = await (self._keys.all() if whose == EVERYBODY else self._keys.of(whose))
        return cut(((each.id, each) for each in found), asked)

    async def show(self, call: Call) -> Answer:
        return Answer(await self._keys.get(acting(call, "key.read", call.asked(One).user), call.path["key"]))

    async def add(self, call: Call) -> Answer:
        owner = acting(call, "key.create", call.asked(One).user)
        wanted = call.body(NewKey)
        if wanted.expires is not None and wanted.expires < time.time():
            raise InvalidRequest("expires: that time is over; it is in seconds since 1970", field="expires")
        role = await self._role(call, owner, wanted.role)
        secret, key = await self._keys.add(owner, role, wanted.label, wanted.expires, wanted.scopes)
        return Answer(MadeKey(secret, key), 201)

    async def _role(self, call: Call, owner: str, wanted: UserRole | None) -> UserRole:
        """What a new key may do: no more than the one with which it is made. Forbidden."""
        own = principal(call).role
        if owner != call.user:
            return wanted or (await self._master.users.get(owner)).role
        if wanted is not None and wanted not in WITHIN[own]:
            raise Forbidden(f"the role {own} cannot make a key of the role {wanted}", field="role")
        return wanted or own

    async def revoke(self, call: Call) -> Answer:
        who, key = principal(call), call.path["key"]
        asked = call.asked(One)
        signs_out = key == who.key and asked.user in ("", who.user)  # whatever else it may do
        owner = acting(call, "whoami" if signs_out else "key.revoke", asked.user)
        call.trail.operation = "key.revoke"
        await self._master.guard.revoke_key(owner, key)
        return Answer(status=204)

    async def rotate(self, call: Call) -> Answer:
        owner = acting(call, "key.rotate", call.asked(One).user)
        secret, key = await self._master.guard.rotate_key(owner, call.path["key"])
        return Answer(MadeKey(secret, key))
