"""`/api/v1/events`: what happens on the platform, as server-sent events."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated

from msgspec import Meta, Struct

from master import rights
from master.api.acting import listing, principal
from master.api.calls import Answer, Call, Everybodys
from master.api.router import Api, Route
from master.api.streams import Piece, Streams
from master.records import State
from master.rights import EVERYBODY, NOBODY, Principal
from master.service import Master
from rce.views import Event

LAST = "Last-Event-ID"


class Followed(Struct, frozen=True, forbid_unknown_fields=True):
    """Which events."""

    user: Everybodys = ""
    type: Annotated[str, Meta(max_length=40, description="those of this type, or kind of type: `environment`")] = ""
    after: Annotated[str, Meta(max_length=40, description="those after this id, as the header Last-Event-ID")] = ""


class EventsApi:
    """The route of events."""

    def __init__(self, master: Master, streams: Streams) -> None:
        self._master = master
        self._streams = streams

    def add_to(self, api: Api) -> None:
        summary = "What happens from now on, or since the event Last-Event-ID"
        api.add(Route("GET", "/events", self.follow, summary, Followed, answer=AsyncIterator[Event]))

    async def follow(self, call: Call) -> Answer:
        asked = call.asked(Followed)
        user = listing(call, "feed.read", asked.user)
        position = self._master.events.position(call.header(LAST) or asked.after)
        pieces = self._pieces(principal(call), user, asked.type, position)
        return Answer(self._streams.stream(principal(call), pieces))

    async def _pieces(self, who: Principal, user: str, type: str, position: int) -> AsyncIterator[Piece]:
        async for event in self._master.events.follow(position):
            wanted = type in ("", event.type, event.type.partition(".")[0]) or event.type == "missed"
            if wanted and _sees(who, self._master.state, user, event):
                yield Piece(event.id, event.type, event)


def _sees(who: Principal, state: State, user: str, event: Event) -> bool:
    if event.type == "missed":
        return True
    if not event.user:
        return user == EVERYBODY and rights.may(who, "machine.read", NOBODY)
    if user not in (EVERYBODY, event.user):
        return False
    if not who.scopes.tied:
        return True
    tags = [side.split("/")[1] for side in event.object.split(" ") if "/" in side]
    return bool(tags) and all(_is_tied_to(who, state, event.user, tag) for tag in tags)


def _is_tied_to(who: Principal, state: State, user: str, tag: str) -> bool:
    """Of what is gone it is not known any more whether it was a robot: it is told to keys that name it."""
    if tag == who.scopes.robot or tag in who.scopes.environments:
        return True
    there = f"{user}/{tag}" in state.environments or f"{user}/{tag}" in state.robots
    return there and rights.sees(who, state, "feed.read", user, tag)
