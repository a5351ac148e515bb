"""Paths of the gateways."""

from __future__ import annotations

from endpoints.gateways.foxglove.client import FoxgloveClient
from endpoints.gateways.paths import gateways
from endpoints.gateways.rosbridge.client import RosbridgeClient
from tests.support.endpoints.platforms import Platform


async def test_first_part_of_a_path_names_the_gateway(platform: Platform) -> None:
    made = gateways(platform.endpoint)
    assert isinstance(made["rosbridge"]("brain"), RosbridgeClient)
    assert isinstance(made["foxglove"]("ann/brain"), FoxgloveClient)
