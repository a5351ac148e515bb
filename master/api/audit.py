"""`/api/v1/audit`: the audit log."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta
from msgspec.structs import replace

from master.access.audit import AuditFilter
from master.access.rights import EVERYBODY
from master.api.principals import authorize_list
from master.api.request import Answer, Call, PageQuery
from master.api.router import Api, Route
from master.service import Master
from rce.api.views import AuditView, Page


class AuditQuery(PageQuery, frozen=True, forbid_unknown_fields=True):
    """Filters of entries; all must match. `object` is a resource and all below it, times are [since, until)."""

    after: Annotated[str, Meta(pattern="^[0-9]{0,18}$", description="`next` of the page before")] = ""
    user: Annotated[str, Meta(max_length=255, description="user whose credentials were used")] = ""
    action: Annotated[str, Meta(max_length=64, description="operation, such as environment.create")] = ""
    object: Annotated[str, Meta(max_length=1500, description="resource, such as ann/brain, and all below it")] = ""
    result: Annotated[str, Meta(max_length=64, description="ok, or the code of an error")] = ""
    since: Annotated[float | None, Meta(description="seconds since 1970")] = None
    until: Annotated[float | None, Meta(description="seconds since 1970")] = None


class AuditApi:
    """Routes of the audit log."""

    def __init__(self, master: Master) -> None:
        self._audit = master.audit

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        api.add(
            Route(
                "GET",
                "/audit",
                self._list,
                "Entries of the audit log, newest first",
                AuditQuery,
                answer=Page[AuditView],
            )
        )

    async def _list(self, call: Call) -> Answer:
        """List entries; users who may not see all get their own, and those about their resources without addresses."""
        query = call.query(AuditQuery)
        owner = authorize_list(call, "audit.read", EVERYBODY)
        wanted = AuditFilter(
            *(query.user, query.action, query.object, query.result, query.since, query.until),
            concerning=None if owner == EVERYBODY else owner,
        )
        found = await self._audit.find(wanted, int(query.after) if query.after else None, query.limit + 1)
        more, found = len(found) > query.limit, found[: query.limit]
        if owner != EVERYBODY:
            found = [each if each.user == owner else replace(each, key="", address="") for each in found]
        return Answer(Page(found, str(found[-1].id) if more else ""))
