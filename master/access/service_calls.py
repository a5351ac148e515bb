"""Calls of services, such as the map service: authentication of their clients, and grants to act for them."""

from __future__ import annotations

from master.access.audit import Audit, Origin
from master.access.rights import check
from master.access.users import Users
from master.graph.records import Process
from rce.api.roles import Principal
from rce.control.calls.call import Nothing
from rce.control.calls.services import Authenticate, CreateGrant, Grant, Identity, IssueKey, RecordAction, RevokeGrant
from rce.control.connection import Handlers
from rce.errors import ErrorInfo, Forbidden, InvalidRequest, RceError


class ServiceCalls:
    """Answers the calls of services."""

    def __init__(self, users: Users, audit: Audit) -> None:
        self._users = users
        self._audit = audit

    def add_handlers(self, handlers: Handlers, process: Process) -> None:
        """Answer the calls of a service."""
        handlers.on(Authenticate, self._authenticate)
        handlers.on(RecordAction, self._record_action)
        handlers.on(CreateGrant, lambda call: self._create_grant(process, call))
        handlers.on(IssueKey, lambda call: self._users.grants.issue_key(process.name, call.grant, call.seconds))
        handlers.on(RevokeGrant, lambda call: self._revoke_grant(process, call))

    async def _record_action(self, call: RecordAction) -> Nothing:
        who = Principal(call.identity.user, "robot", call.identity.key)
        error = None if call.result == "ok" else RceError.from_info(ErrorInfo(call.result, ""))
        self._audit.note(who, call.action, who.user, call.object, Origin("map-service", call.address), error)
        return Nothing()

    async def _authenticate(self, call: Authenticate) -> Identity:
        principal = await self._client(call.user, call.secret, call.address, call.operation)
        return Identity(principal.user, principal.role, principal.key)

    async def _create_grant(self, process: Process, call: CreateGrant) -> Grant:
        principal = await self._client(call.user, call.secret, call.address, "job.submit")
        return Grant(await self._users.grants.give(process.name, principal.user, principal.key))

    async def _revoke_grant(self, process: Process, call: RevokeGrant) -> Nothing:
        await self._users.grants.end(process.name, call.grant)
        return Nothing()

    async def _client(self, user: str, secret: str, address: str, operation: str) -> Principal:
        """Authenticate a client and check the operation; refusals are audited."""
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
        """Check that somebody may have a service act for them; a service that acts for a user may not."""
        if principal.lent:
            raise Forbidden("this key is a temporary key of a service, for robots only")
        if operation not in ("job.read", "job.submit"):
            raise InvalidRequest(f"{operation[:80]!r} is no operation on jobs", field="operation")
        check(principal, operation, principal.user)
