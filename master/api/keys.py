"""`/api/v1/keys`: API keys, whose secrets are shown once."""

from __future__ import annotations

import time

from master.access.rights import EVERYBODY, check_credential
from master.api.principals import authorize, authorize_list, page_of_views, principal_of
from master.api.request import Answer, Call, ListQuery, OwnerQuery
from master.api.router import Api, Route
from master.service import Master
from rce.api.views import CreatedKey, KeyView, NewKey, Page
from rce.errors import InvalidRequest

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
        principal = principal_of(call)
        role = wanted.role or (principal.role if owner == call.user else (await self._master.users.get(owner)).role)
        check_credential(principal, role, wanted.scopes)
        secret, key = await self._keys.add(owner, role, wanted.label, wanted.expires, wanted.scopes, principal.key)
        return Answer(CreatedKey(secret, key), 201)

    async def _revoke(self, call: Call) -> Answer:
        principal, key = principal_of(call), call.path["key"]
        query = call.query(OwnerQuery)
        own = key == principal.key and not principal.lent
        signs_out = own and query.user in ("", principal.user)  # which every key may
        owner = authorize(call, "whoami" if signs_out else "key.revoke", query.user)
        call.audit.operation = "key.revoke"
        if not signs_out:
            await self._check_target(call, owner)
        await self._master.guard.revoke_key(owner, key)
        return Answer(status=204)

    async def _rotate(self, call: Call) -> Answer:
        owner = authorize(call, "key.rotate", call.query(OwnerQuery).user)
        await self._check_target(call, owner)
        secret, key = await self._master.guard.rotate_key(owner, call.path["key"], principal_of(call).key)
        return Answer(CreatedKey(secret, key))

    async def _check_target(self, call: Call, owner: str) -> None:
        """Check that the key in the path may do no more than the caller.

        Raises:
            NotFound: The owner has no such key.
            Forbidden: It may do more.
        """
        target = await self._keys.get(owner, call.path["key"])
        check_credential(principal_of(call), target.role, target.scopes)
