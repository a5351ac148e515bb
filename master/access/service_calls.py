"""Calls of services, such as the map service: authentication of their clients, and grants to act for them."""

from __future__ import annotations

from master.access.audit import Audit, Origin
from master.access.rights import check, reach
from master.access.users import Users
from master.graph.records import Process
from rce.api.roles import Principal
from rce.control.calls.call import Nothing
from rce.control.calls.services import Authenticate, CreateGrant, Grant, Identity, IssueKey, RecordAction, RevokeGrant
from rce.control.connection import Handlers
from rce.errors import ErrorInfo, Forbidden, InvalidRequest, RceError

OPERATIONS = ("job.read", "job.submit", "knowledge.read", "knowledge.write")
"""Operations for which services ask."""


class ServiceCalls:
    """Answers the calls of services."""

    def __init__(self, users: Users, audit: Audit) -> None:
        self._users = users
        self._audit = audit

    def add_handlers(self, handlers: Handlers, process: Process) -> None:
        """Answer the calls of a service."""
        handlers.on(Authenticate, lambda call: self._authenticate(process, call))
        handlers.on(RecordAction, lambda call: self._record_action(process, call))
        handlers.on(CreateGrant, lambda call: self._create_grant(process, call))
        handlers.on(IssueKey, lambda call: self._users.grants.issue_key(process.name, call.grant, call.seconds))
        handlers.on(RevokeGrant, lambda call: self._revoke_grant(process, call))

    async def _record_action(self, process: Process, call: RecordAction) -> Nothing:
        who = Principal(call.identity.user, "robot", call.identity.key)
        error = None if call.result == "ok" else RceError.from_info(ErrorInfo(call.result, ""))
        self._audit.note(who, call.action, who.user, call.object, Origin(process.name, call.address), error)
        return Nothing()

    async def _authenticate(self, process: Process, call: Authenticate) -> Identity:
        principal = await self._client(process, call, call.operation)
        return Identity(principal.user, principal.role, principal.key, reach(principal, call.operation))

    async def _create_grant(self, process: Process, call: CreateGrant) -> Grant:
        principal = await self._client(process, call, "job.submit")
        return Grant(await self._users.grants.give(process.name, principal.user, principal.key))

    async def _revoke_grant(self, process: Process, call: RevokeGrant) -> Nothing:
        await self._users.grants.end(process.name, call.grant)
        return Nothing()

    async def _client(self, process: Process, call: Authenticate | CreateGrant, operation: str) -> Principal:
        """Authenticate a client and check the operation; refusals are audited."""
        origin, principal = Origin(process.name, call.address), None
        try:
            principal = await self._users.check(call.user, call.secret, call.address)
            self._check(principal, operation)
        except RceError as error:
            owner = principal.user if principal else call.user
            self._audit.note(principal, operation if principal else "login", owner, owner, origin, error)
            raise
        return principal

    def _check(self, principal: Principal, operation: str) -> None:
        """Check that somebody may have a service act for them; a service that acts for a user may not."""
        if principal.lent:
            raise Forbidden("this key is a temporary key of a service, for robots only")
        if operation not in OPERATIONS:
            raise InvalidRequest(f"{operation[:80]!r} is no operation of a service", field="operation")
        check(principal, operation, principal.user)
