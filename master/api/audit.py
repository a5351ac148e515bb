"""`/api/v1/audit`: what was done, by whom, from where, with what result."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta
from msgspec.structs import replace

from master.api.acting import listing
from master.api.calls import Answer, Call, Paging
from master.api.router import Api, Route
from master.audit import Wanted
from master.rights import EVERYBODY
from master.service import Master
from rce.views import AuditView, Page


class Asked(Paging, frozen=True, forbid_unknown_fields=True):
    """Which entries: all that are given must fit. `object` is one thing and all below; times are [since, until)."""

    after: Annotated[str, Meta(pattern="^[0-9]{0,18}$", description="`next` of the page before")] = ""
    user: Annotated[str, Meta(max_length=255, description="who did it")] = ""
    action: Annotated[str, Meta(max_length=64, description="as environment.create")] = ""
    object: Annotated[str, Meta(max_length=1500, description="as ann/brain, and all below")] = ""
    result: Annotated[str, Meta(max_length=64, description="ok, or the code of an error")] = ""
    since: Annotated[float | None, Meta(description="seconds since 1970")] = None
    until: Annotated[float | None, Meta(description="seconds since 1970")] = None


class AuditApi:
    """The audit log."""

    def __init__(self, master: Master) -> None:
        self._audit = master.audit

    def add_to(self, api: Api) -> None:
        api.add(Route("GET", "/audit", self.list, "What was done, the newest first", Asked, answer=Page[AuditView]))

    async def list(self, call: Call) -> Answer:
        """To those who may not see all: what they did, and what was done to their things, not from where."""
        asked = call.asked(Asked)
        whose = listing(call, "audit.read", EVERYBODY)
        wanted = Wanted(
            *(asked.user, asked.action, asked.object, asked.result, asked.since, asked.until),
            concerning=None if whose == EVERYBODY else whose,
        )
        found = await self._audit.find(wanted, int(asked.after) if asked.after else None, asked.limit + 1)
        more, found = len(found) > asked.limit, found[: asked.limit]
        if whose != EVERYBODY:
            found = [each if each.user == whose else replace(each, key="", address="") for each in found]
        return Answer(Page(found, str(found[-1].id) if more else ""))
