"""`/api/v1/events`: events of the platform as server-sent events."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated

from msgspec import Meta, Struct

from master.access import rights
from master.access.rights import EVERYBODY, NOBODY, Principal
from master.api.principals import authorize_list, principal_of
from master.api.request import Answer, Call, OwnerOrAll
from master.api.router import Api, Route
from master.api.streams import EventStreams, ServerSentEvent
from master.graph.state import State
from master.service import Master
from rce.api.views import Event

LAST_EVENT_ID = "Last-Event-ID"


class EventsQuery(Struct, frozen=True, forbid_unknown_fields=True):
    """Filters of events."""

    user: OwnerOrAll = ""
    type: Annotated[str, Meta(max_length=40, description="of this type, or of this kind: `environment`")] = ""
    after: Annotated[str, Meta(max_length=40, description="after this id, as the header Last-Event-ID")] = ""


class EventsApi:
    """Route of events."""

    def __init__(self, master: Master, streams: EventStreams) -> None:
        self._master = master
        self._streams = streams

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        summary = "Events from now on, or after the one in Last-Event-ID"
        api.add(Route("GET", "/events", self._follow, summary, EventsQuery, answer=AsyncIterator[Event]))

    async def _follow(self, call: Call) -> Answer:
        query = call.query(EventsQuery)
        user = authorize_list(call, "feed.read", query.user)
        position = self._master.events.position(call.header(LAST_EVENT_ID) or query.after)
        events = self._events(principal_of(call), user, query.type, position)
        return Answer(self._streams.stream(principal_of(call), events))

    async def _events(self, who: Principal, user: str, type: str, position: int) -> AsyncIterator[ServerSentEvent]:
        async for event in self._master.events.follow(position):
            wanted = type in ("", event.type, event.type.partition(".")[0]) or event.type == "missed"
            if wanted and _sees(who, self._master.state, user, event):
                yield ServerSentEvent(event.id, event.type, event)


def _sees(who: Principal, state: State, user: str, event: Event) -> bool:
    if event.type == "missed":
        return True
    if event.public:
        return rights.may(who, "knowledge.read", who.user)
    if not event.user:
        return user == EVERYBODY and rights.may(who, "machine.read", NOBODY)
    if user not in (EVERYBODY, event.user):
        return False
    if not who.scopes.tied:
        return True
    tags = [side.split("/")[1] for side in event.object.split(" ") if "/" in side]
    return bool(tags) and all(_is_tied_to(who, state, event.user, tag) for tag in tags)


def _is_tied_to(who: Principal, state: State, user: str, tag: str) -> bool:
    """Return whether a restricted key names this robot or environment, or may see it as one that exists.

    What is gone cannot be looked up any more, so only keys that name it are told.
    """
    if tag == who.scopes.robot or tag in who.scopes.environments:
        return True
    there = f"{user}/{tag}" in state.environments or f"{user}/{tag}" in state.robots
    return there and rights.sees(who, state, "feed.read", user, tag)
