"""What services such as the map service ask the Master: who a client is, and for the right to act for them."""

from __future__ import annotations

from master.audit import Audit, Origin
from master.records import Process
from master.rights import check
from master.users import Users
from rce import calls as c
from rce.control import Handlers
from rce.errors import Forbidden, InvalidRequest, RceError
from rce.roles import Principal


class Lending:
    """The calls of services."""

    def __init__(self, users: Users, audit: Audit) -> None:
        self._users = users
        self._audit = audit

    def add_to(self, handlers: Handlers, process: Process) -> None:
        handlers.on(c.Vouch, self._vouch)
        handlers.on(c.Delegate, lambda call: self._delegate(process, call))
        handlers.on(c.Borrow, lambda call: self._users.grants.borrow(process.name, call.grant, call.seconds))
        handlers.on(c.EndGrant, lambda call: self._end_grant(process, call))

    async def _vouch(self, call: c.Vouch) -> c.Person:
        principal = await self._client(call.user, call.secret, call.address, call.operation)
        return c.Person(principal.user, principal.role)

    async def _delegate(self, process: Process, call: c.Delegate) -> c.Grant:
        principal = await self._client(call.user, call.secret, call.address, "job.submit", gives=True)
        return c.Grant(await self._users.grants.give(process.name, principal.user, principal.key))

    async def _end_grant(self, process: Process, call: c.EndGrant) -> c.Nothing:
        await self._users.grants.end(process.name, call.grant)
        return c.Nothing()

    async def _client(self, user: str, secret: str, address: str, operation: str, gives: bool = False) -> Principal:
        """Who may do this; noted when they give a service the right to act for them, and when they are refused."""
        origin, principal = Origin("map-service", address), None
        try:
            principal = await self._users.check(user, secret, address)
            self._check(principal, operation)
        except RceError as error:
            owner = principal.user if principal else user
            self._audit.note(principal, operation if principal else "login", owner, owner, origin, error)
            raise
        if gives:
            self._audit.note(principal, operation, principal.user, principal.user, origin)
        return principal

    def _check(self, principal: Principal, operation: str) -> None:
        """Who may have a service act as a robot of theirs: not a service that acts for somebody already."""
        if principal.lent:
            raise Forbidden("this key was lent to a service and is for robots only")
        if operation not in ("job.read", "job.submit"):
            raise InvalidRequest(f"{operation[:80]!r} is not of jobs", field="operation")
        check(principal, operation, principal.user)
