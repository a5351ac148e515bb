"""What services such as the map service ask the Master: who a client is, and for the right to act for them."""

from __future__ import annotations

from master.records import Process
from master.rights import check
from master.users import Users
from rce import calls as c
from rce.control import Handlers
from rce.errors import Forbidden, InvalidRequest
from rce.roles import Principal


class Lending:
    """The calls of services."""

    def __init__(self, users: Users) -> None:
        self._users = users

    def add_to(self, handlers: Handlers, process: Process) -> None:
        handlers.on(c.Vouch, self._vouch)
        handlers.on(c.Delegate, lambda call: self._delegate(process, call))
        handlers.on(c.Borrow, lambda call: self._users.grants.borrow(process.name, call.grant, call.seconds))
        handlers.on(c.EndGrant, lambda call: self._end_grant(process, call))

    async def _vouch(self, call: c.Vouch) -> c.Person:
        principal = await self._client(call.user, call.secret, call.address, call.operation)
        return c.Person(principal.user, principal.role)

    async def _delegate(self, process: Process, call: c.Delegate) -> c.Grant:
        principal = await self._client(call.user, call.secret, call.address, "job.submit")
        return c.Grant(await self._users.grants.give(process.name, principal.user, principal.key))

    async def _end_grant(self, process: Process, call: c.EndGrant) -> c.Nothing:
        await self._users.grants.end(process.name, call.grant)
        return c.Nothing()

    async def _client(self, user: str, secret: str, address: str, operation: str) -> Principal:
        """Who may have a service act as a robot of theirs: not a service that acts for somebody already."""
        principal = await self._users.check(user, secret, address)
        if principal.lent:
            raise Forbidden("this key was lent to a service and is for robots only")
        if operation not in ("job.read", "job.submit"):
            raise InvalidRequest(f"{operation[:80]!r} is not of jobs", field="operation")
        check(principal, operation, principal.user)
        return principal
