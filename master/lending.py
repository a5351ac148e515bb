"""What services such as the map service ask the Master: who a client is, and for the right to act for them."""

from __future__ import annotations

from master.audit import Audit, Origin
from master.records import Process
from master.rights import check
from master.users import Users
from rce.calls.call import Nothing
from rce.calls.services import Borrow, Delegate, EndGrant, Grant, NoteDone, Person, Vouch
from rce.control import Handlers
from rce.errors import ErrorInfo, Forbidden, InvalidRequest, RceError
from rce.roles import Principal


class Lending:
    """The calls of services."""

    def __init__(self, users: Users, audit: Audit) -> None:
        self._users = users
        self._audit = audit

    def add_to(self, handlers: Handlers, process: Process) -> None:
        handlers.on(Vouch, self._vouch)
        handlers.on(NoteDone, self._note)
        handlers.on(Delegate, lambda call: self._delegate(process, call))
        handlers.on(Borrow, lambda call: self._users.grants.borrow(process.name, call.grant, call.seconds))
        handlers.on(EndGrant, lambda call: self._end_grant(process, call))

    async def _note(self, call: NoteDone) -> Nothing:
        who = Principal(call.person.user, "robot", call.person.key)
        error = None if call.result == "ok" else RceError.from_info(ErrorInfo(call.result, ""))
        self._audit.note(who, call.action, who.user, call.object, Origin("map-service", call.address), error)
        return Nothing()

    async def _vouch(self, call: Vouch) -> Person:
        principal = await self._client(call.user, call.secret, call.address, call.operation)
        return Person(principal.user, principal.role, principal.key)

    async def _delegate(self, process: Process, call: Delegate) -> Grant:
        principal = await self._client(call.user, call.secret, call.address, "job.submit")
        return Grant(await self._users.grants.give(process.name, principal.user, principal.key))

    async def _end_grant(self, process: Process, call: EndGrant) -> Nothing:
        await self._users.grants.end(process.name, call.grant)
        return Nothing()

    async def _client(self, user: str, secret: str, address: str, operation: str) -> Principal:
        """Who may do this; noted when they are refused."""
        origin, principal = Origin("map-service", address), None
        try:
            principal = await self._users.check(user, secret, address)
            self._check(principal, operation)
        except RceError as error:
            owner = principal.user if principal else user
            self._audit.note(principal, operation if principal else "login", owner, owner, origin, error)
            raise
        return principal

    def _check(self, principal: Principal, operation: str) -> None:
        """Who may have a service act as a robot of theirs: not a service that acts for somebody already."""
        if principal.lent:
            raise Forbidden("this key was lent to a service and is for robots only")
        if operation not in ("job.read", "job.submit"):
            raise InvalidRequest(f"{operation[:80]!r} is not of jobs", field="operation")
        check(principal, operation, principal.user)
