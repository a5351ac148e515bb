"""`/api/v1/keys`: API keys, whose secrets are shown once."""

from __future__ import annotations

import time

from master.access.rights import EVERYBODY
from master.api.principals import authorize, authorize_list, page_of_views, principal_of
from master.api.request import Answer, Call, ListQuery, OwnerQuery
from master.api.router import Api, Route
from master.service import Master
from rce.api.roles import ASSIGNABLE_ROLES, UserRole
from rce.api.views import CreatedKey, KeyView, NewKey, Page
from rce.errors import Forbidden, InvalidRequest

KEY = "/keys/{key}"


class KeysApi:
    """Routes of API keys."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._keys = master.users.keys

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        api.add(
            Route("GET", "/keys", self._list, "API keys", ListQuery, answer=Page[KeyView]),
            Route("POST", "/keys", self._add, "Create an API key", OwnerQuery, NewKey, CreatedKey, 201),
            Route("GET", KEY, self._show, "An API key", OwnerQuery, answer=KeyView),
            Route(
                "DELETE",
                KEY,
                self._revoke,
                "Revoke an API key; connections that it opened are closed",
                OwnerQuery,
                status=204,
            ),
            Route(
                "POST",
                KEY + "/rotate",
                self._rotate,
                "Replace the secret of an API key; the old one is revoked",
                OwnerQuery,
                answer=CreatedKey,
            ),
        )

    async def _list(self, call: Call) -> Answer:
        query = call.query(ListQuery)
        owner = authorize_list(call, "key.read", query.user)
        found = await (self._keys.all() if owner == EVERYBODY else self._keys.of(owner))
        return page_of_views(((each.id, each) for each in found), query)

    async def _show(self, call: Call) -> Answer:
        return Answer(await self._keys.get(authorize(call, "key.read", call.query(OwnerQuery).user), call.path["key"]))

    async def _add(self, call: Call) -> Answer:
        owner = authorize(call, "key.create", call.query(OwnerQuery).user)
        wanted = call.body(NewKey)
        if wanted.expires is not None and wanted.expires < time.time():
            raise InvalidRequest("expires: this time has passed; it is in seconds since 1970", field="expires")
        role = await self._role(call, owner, wanted.role)
        secret, key = await self._keys.add(owner, role, wanted.label, wanted.expires, wanted.scopes)
        return Answer(CreatedKey(secret, key), 201)

    async def _role(self, call: Call, owner: str, wanted: UserRole | None) -> UserRole:
        """Return the role of a new key, which may do no more than the credentials with which it is created.

        Raises:
            Forbidden: It could do more.
        """
        own = principal_of(call).role
        if owner != call.user:
            return wanted or (await self._master.users.get(owner)).role
        if wanted is not None and wanted not in ASSIGNABLE_ROLES[own]:
            raise Forbidden(f"the role {own} cannot make a key of the role {wanted}", field="role")
        return wanted or own

    async def _revoke(self, call: Call) -> Answer:
        principal, key = principal_of(call), call.path["key"]
        query = call.query(OwnerQuery)
        own = key == principal.key and not principal.lent
        signs_out = own and query.user in ("", principal.user)  # which every key may
        owner = authorize(call, "whoami" if signs_out else "key.revoke", query.user)
        call.audit.operation = "key.revoke"
        await self._master.guard.revoke_key(owner, key)
        return Answer(status=204)

    async def _rotate(self, call: Call) -> Answer:
        owner = authorize(call, "key.rotate", call.query(OwnerQuery).user)
        secret, key = await self._master.guard.rotate_key(owner, call.path["key"])
        return Answer(CreatedKey(secret, key))
