"""Offers to a Foxglove client: channels of the topics and the services of the environment, each under a number."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

from endpoints.gateways.definitions import message_text
from endpoints.gateways.foxglove.packets import TYPES
from endpoints.gateways.guest import Guest
from rce.control.calls.robots import Sort
from rce.control.calls.watching import RosGraph, RosName
from rce.errors import LimitExceeded, RceError
from rce.protocol.names import parse_type

PATIENCE = 1.0  # seconds for which the offers of a moment wait for descriptions; others follow with a later graph
RETRY = 30.0  # seconds until a type that nobody could describe is asked for again


class Offer(NamedTuple):
    """Topic or service: its ROS name, its type, and the schemas of its messages.

    With a `codec` it is an additional channel for the packets of a topic, with the name `TOPIC/CODEC`.
    """

    name: str
    type: str
    schemas: tuple[str, ...]
    codec: str = ""


class Changes(NamedTuple):
    """Offers that came, by number, and the numbers of those that went."""

    added: dict[int, Offer]
    removed: list[int]


class Offers:
    """Offers of one sort for one client. What has a type that nobody can describe is left out.

    Args:
        guest: The client's guest.
        sort: `msg` for topics, `srv` for services.
        codecs: Codecs for which topics get an additional channel.
    """

    def __init__(self, guest: Guest, sort: Sort, codecs: Sequence[str] = ()) -> None:
        self._guest = guest
        self._sort: Sort = sort
        self._codecs = codecs
        self._numbers = itertools.count(1)
        self._schemas: dict[str, tuple[str, ...]] = {}
        self._unknown: dict[str, float] = {}  # types that nobody can describe, with the time at which to ask again
        self._asked: dict[str, asyncio.Future[None]] = {}  # types whose description is under way
        self.by_number: dict[int, Offer] = {}

    async def update(self, graph: RosGraph) -> Changes:
        """Compare with the graph, and return what has changed."""
        every = graph.topics if self._sort == "msg" else graph.services
        wanted = self._with_packets({each.name: each.types[0] for each in every if self._is_shown(each)})
        present = {(offer.name, offer.type): number for number, offer in self.by_number.items()}
        removed = [number for key, number in present.items() if key not in wanted]
        for number in removed:
            del self.by_number[number]
        missing = sorted(wanted.keys() - present.keys())
        await self._describe({type for _, type in missing})
        known = [
            Offer(name, type, self._schemas[type], wanted[name, type])
            for name, type in missing
            if type in self._schemas
        ]
        added = {next(self._numbers): offer for offer in known}
        self.by_number |= added
        return Changes(added, removed)

    def _with_packets(self, shown: Mapping[str, str]) -> dict[tuple[str, str], str]:
        """Return the codec of each channel by name and type, empty for what the environment itself has."""
        wanted = dict.fromkeys(shown.items(), "")
        for codec in self._codecs:
            topic_type, packet_type = TYPES[codec]
            spellings = topic_type, topic_type.replace("/msg/", "/")  # other participants of DDS may have any name
            names = [name for name, type in shown.items() if type in spellings]
            wanted |= {(f"{name}/{codec}", packet_type): codec for name in names if f"{name}/{codec}" not in shown}
        return wanted

    def _is_shown(self, each: RosName) -> bool:
        return bool(each.types) and (self._sort == "srv" or each.publishers > 0)

    async def _describe(self, types: set[str]) -> None:
        """Ask for the schemas of types at the same time; stop waiting after PATIENCE."""
        loop = asyncio.get_running_loop()
        for type in types - self._schemas.keys() - self._asked.keys():
            if loop.time() >= self._unknown.get(type, 0.0):
                with suppress(LimitExceeded):  # the client has much to do; it is asked for with a later graph
                    self._guest.run(self._ask(type))
                    self._asked[type] = loop.create_future()
        if under_way := [self._asked[type] for type in types if type in self._asked]:
            await asyncio.wait(under_way, timeout=PATIENCE)

    async def _ask(self, type: str) -> None:
        try:
            schemas = await self._schemas_of(type)
            if schemas is None:
                self._unknown[type] = asyncio.get_running_loop().time() + RETRY
            else:
                self._schemas[type] = schemas
        finally:
            self._asked.pop(type).set_result(None)

    async def _schemas_of(self, type: str) -> tuple[str, ...] | None:
        try:
            name = parse_type(type)
            found = await self._guest.view.definitions(str(name), self._sort)
        except RceError:
            return None
        if self._sort == "msg":
            return (message_text(found, name.msg),)
        return tuple(message_text(found, name.srv + part) for part in ("_Request", "_Response"))


def channel(number: int, offer: Offer) -> dict[str, object]:
    """Return the record of a channel."""
    return {
        "id": number,
        "topic": offer.name,
        "encoding": "cdr",
        "schemaName": offer.type,
        "schemaEncoding": "ros2msg",
        "schema": offer.schemas[0],
    }


def service(number: int, offer: Offer) -> dict[str, object]:
    """Return the record of a service."""
    request, response = (
        {"encoding": "cdr", "schemaName": offer.type + part, "schemaEncoding": "ros2msg", "schema": schema}
        for part, schema in zip(("_Request", "_Response"), offer.schemas, strict=True)
    )
    return {"id": number, "name": offer.name, "type": offer.type, "request": request, "response": response}


Connections = dict[str, dict[str, list[str]]]
"""Nodes of each topic and service, by the titles that a connection graph has for them."""
TITLES = {"publishedTopics": "publisherIds", "subscribedTopics": "subscriberIds", "advertisedServices": "providerIds"}


def connections(graph: RosGraph) -> Connections:
    """Return the nodes of each topic and service."""
    found: Connections = {title: {} for title in TITLES}
    for node in graph.nodes:
        for title, names in zip(found, (node.publishes, node.subscribes, node.serves), strict=True):
            for name in names:
                found[title].setdefault(name, []).append(node.name)
    return found


def graph_update(found: Connections, known: Connections) -> dict[str, object]:
    """Return the fields of a connectionGraphUpdate, given what a client knows."""

    def names(of: Connections, *titles: str) -> set[str]:
        return set[str]().union(*(of.get(title, {}) for title in titles))

    update: dict[str, object] = {}
    for title, key in TITLES.items():
        before, now = known.get(title, {}), found[title]
        changed = [name for name in sorted({*before, *now}) if before.get(name) != now.get(name)]
        update[title] = [{"name": name, key: now.get(name, [])} for name in changed]
    topics = ("publishedTopics", "subscribedTopics")
    update["removedTopics"] = sorted(names(known, *topics) - names(found, *topics))
    update["removedServices"] = sorted(names(known, "advertisedServices") - names(found, "advertisedServices"))
    return update
