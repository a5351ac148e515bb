"""Services of a catalogue for tests."""

from __future__ import annotations

from typing import Any

from master.graph import catalogue
from master.graph.catalogue_records import Offer
from rce.api.views import NewOffer, OfferedNode, OfferedPort
from tests.support.master.fleet import Fleet, furnished

STRING = "std_msgs/String"
NODES = [OfferedNode("core", "p", "core"), OfferedNode("part", "p", "part", perRobot=True, parameters={"rate": 2})]


def declared(**changes: Any) -> NewOffer:
    """Return the declaration of a shared service with a topic in each direction, and one that all robots share."""
    fields: dict[str, Any] = {
        "name": "parrot",
        "takes": {"say": STRING},
        "gives": {"heard": OfferedPort(STRING), "news": OfferedPort(STRING, "/news")},
        "nodes": NODES,
        "robots": 2,
        "most": 2,
        "idle": 10.0,
    }
    return NewOffer(**fields | changes)


def offering(**changes: Any) -> tuple[Fleet, Offer]:
    """Return a fleet in which ann offers a service; robots are ann/r1 and bob/r1."""
    fleet = furnished()
    return fleet, catalogue.publish(fleet.state, "ann", declared(**changes), fleet.ids)
