"""Requests of environments to the knowledge service: the Master checks, audits and forwards them."""

from __future__ import annotations

from collections import Counter

from master.access import rights
from master.access.audit import Audit, Origin
from master.access.users import Users
from master.execution.dispatcher import Dispatcher
from master.graph.records import Process
from rce.api.knowledge_requests import (
    AddEntry,
    ChangeEntry,
    KnowledgeAnswer,
    KnowledgeRequest,
    PutPiece,
    Reading,
    RemoveEntry,
    RemoveFile,
    Writing,
)
from rce.api.roles import Principal
from rce.control.calls.knowledge import SERVICE, AnswerKnowledge, AskKnowledge
from rce.errors import LimitExceeded, Unavailable

AT_ONCE = 8  # requests of one environment
TIMEOUT = 50.0  # seconds for the service; less than the environment waits
ACTIONS: dict[type[Writing], str] = {
    AddEntry: "knowledge.add",
    ChangeEntry: "knowledge.change",
    RemoveEntry: "knowledge.remove",
    PutPiece: "knowledge.put_file",
    RemoveFile: "knowledge.remove_file",
}
"""Audited requests, named as at the service's HTTP interface."""


class KnowledgeCalls:
    """Answers the calls of environments."""

    def __init__(self, users: Users, audit: Audit, dispatcher: Dispatcher) -> None:
        self._users = users
        self._audit = audit
        self._dispatcher = dispatcher
        self._waiting: Counter[str] = Counter()  # requests by environment

    async def answer(self, process: Process, call: AskKnowledge) -> KnowledgeAnswer:
        """Answer a call of an environment.

        Raises:
            Forbidden: Its owner may not do this.
            LimitExceeded: Too many of its requests wait.
            Unavailable: The service is away.
            RceError: The service refuses the request.
        """
        name = process.name
        if self._waiting[name] >= AT_ONCE:
            raise LimitExceeded(f"environment {name} has {AT_ONCE} requests to the knowledge service under way")
        self._waiting[name] += 1
        try:
            return await self._forward(name, call.request)
        finally:
            self._waiting[name] -= 1
            self._waiting += Counter()  # drops those with none

    async def _forward(self, name: str, request: KnowledgeRequest) -> KnowledgeAnswer:
        user, _, tag = name.partition("/")
        if isinstance(request, Reading):
            await self._check(user, "knowledge.read")
            return await self._ask(name, request)
        origin = Origin("environment", tag)
        with self._audit.auditing(ACTIONS[type(request)], user, f"{user}/{_thing(request)}", origin) as noted:
            noted.who = await self._check(user, "knowledge.write")
            noted.quiet = isinstance(request, PutPiece) and not request.last
            return await self._ask(name, request)

    async def _check(self, user: str, operation: str) -> Principal:
        """Check that a user may do something, and return the user."""
        who = Principal(user, (await self._users.get(user)).role)
        rights.check(who, operation, user)
        return who

    async def _ask(self, name: str, request: KnowledgeRequest) -> KnowledgeAnswer:
        if SERVICE not in self._dispatcher.controls:
            raise Unavailable("the knowledge service is away at present, or not part of this platform")
        return await self._dispatcher.ask(SERVICE, AnswerKnowledge(name, request), TIMEOUT)


def _thing(request: Writing) -> str:
    """Return the name of what a request changes."""
    match request:
        case AddEntry(new):
            return f"{new.kind}/{new.cls}.{new.id}"
        case PutPiece(kind, uid, file) | RemoveFile(kind, uid, file):
            return f"{kind}/{uid}/{file}"
        case ChangeEntry(kind, uid) | RemoveEntry(kind, uid):
            return f"{kind}/{uid}"
