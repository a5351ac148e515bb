"""Paths of the gateways at the port of the Robot endpoint."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from endpoints.gateways.foxglove.client import FoxgloveClient
from endpoints.gateways.graphs import Graphs
from endpoints.gateways.rosbridge.client import RosbridgeClient
from endpoints.robot.client import Choose
from endpoints.robot.endpoint import RobotEndpoint


def gateways(endpoint: RobotEndpoint) -> Mapping[str, Choose]:
    """Return the gateways by the first part of their paths; each makes a client for the rest of a path."""
    graphs = Graphs()
    return {
        "rosbridge": partial(RosbridgeClient, endpoint, graphs),
        "foxglove": partial(FoxgloveClient, endpoint, graphs),
    }
