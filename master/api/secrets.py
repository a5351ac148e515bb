"""`/api/v1/secrets`: users' secrets, which are written and never read."""

from __future__ import annotations

import time

from master.access.sealing import Seal
from master.api.principals import authorize, page_of_views
from master.api.request import Answer, Call, PageQuery
from master.api.router import Api, Route
from master.graph import secrets
from master.service import Master
from rce.api.views import NewSecret, Page, SecretView


class SecretsApi:
    """Routes of secrets."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._state = master.state
        self._seal: Seal = master.seal

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        api.add(
            Route("GET", "/secrets", self._list, "Names of your secrets", PageQuery, answer=Page[SecretView]),
            Route(
                *("POST", "/secrets", self._set, "Set a secret, which is never shown again"),
                *(None, NewSecret, SecretView, 201),
            ),
            Route("DELETE", "/secrets/{name}", self._remove, "Remove a secret", status=204),
        )

    async def _list(self, call: Call) -> Answer:
        user = authorize(call, "secret.read", "")
        own = self._state.secrets.by(user)
        views = ((each.key, SecretView(each.name.partition("/")[2], each.created)) for each in own)
        return page_of_views(views, call.query(PageQuery))

    async def _set(self, call: Call) -> Answer:
        user = authorize(call, "secret.set", "")
        wanted = call.body(NewSecret)
        secret = secrets.put(self._state, user, wanted.name, self._seal.close(wanted.value), time.time())
        await self._master.save()
        return Answer(SecretView(wanted.name, secret.created), 201)

    async def _remove(self, call: Call) -> Answer:
        user = authorize(call, "secret.remove", "")
        secrets.remove(self._state, user, call.path["name"])
        await self._master.save()
        return Answer(status=204)
