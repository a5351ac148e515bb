"""Routes between two environments: the measuring node is in one, the echo node in the other."""

from __future__ import annotations

from rce.bench.nodes import MeasuringNode, Place, Probe, start, start_connected
from rce.bench.payloads import SERVICE_TYPE
from rce.client import Environment, Robot
from rce.errors import InvalidRequest

TYPES = {"string": "std_msgs/String", "bytes": "std_msgs/UInt8MultiArray"}
KINDS = [*TYPES, "service"]


async def c2c(place: Place) -> list[Probe]:
    """Connect two environments on one machine through interfaces of the platform (C2C-1 in the Rapyuta paper)."""
    other = await _environment(place, "c2c")
    node = await _connected(place.robot, place.environment, other, "c2c")
    return node.probes("c2c", KINDS, beside="n2n")


async def c2c2(place: Place) -> list[Probe]:
    """Connect two environments on two machines through interfaces of the platform (C2C-2 in the Rapyuta paper).

    Raises:
        InvalidRequest: `features` does not name two machines.
    """
    if len(place.features) != 2:
        raise InvalidRequest(
            "the route c2c2 needs --features ONE,OTHER: two special features, each of a single machine"
        )
    one, other = [await _environment(place, f"on_{feature}", features=[feature]) for feature in place.features]
    node = await _connected(place.robot, one, other, "c2c2")
    return node.probes("c2c2", KINDS, beside="n2n")


async def group(place: Place) -> list[Probe]:
    """Connect two environments by ROS 2 alone, over the network of a group."""
    one, other = [await _environment(place, f"group{number}", group=place.environment.tag) for number in range(2)]
    node = await start_connected(one, other, "group", KINDS)
    return node.probes("group", KINDS, beside="n2n")


async def _environment(place: Place, name: str, group: str = "", features: list[str] | None = None) -> Environment:
    """Create an environment that is destroyed with the place."""
    made = place.robot.environment(
        f"{place.environment.tag}_{name}", group=group, special_features=features or [], restart="no"
    )
    return await place.stack.enter_async_context(made)


async def _connected(robot: Robot, one: Environment, other: Environment, route: str) -> MeasuringNode:
    """Connect topics of two environments in both directions, and a service of the other to the one; start the nodes."""
    for kind, type_name in TYPES.items():
        for sender, receiver, topic in ((one, other, kind), (other, one, f"{kind}_back")):
            address = f"/{route}/{topic}"
            await robot.add_interface(sender.tag, f"{topic}_out", "SubscriberInterface", type_name, addr=address)
            await robot.add_interface(receiver.tag, f"{topic}_in", "PublisherInterface", type_name, addr=address)
            await robot.connect(f"{sender.tag}/{topic}_out", f"{receiver.tag}/{topic}_in")
    address = f"/{route}/service"
    await robot.add_interface(one.tag, "service", "ServiceProviderInterface", SERVICE_TYPE, addr=address)
    await robot.add_interface(other.tag, "service", "ServiceClientInterface", SERVICE_TYPE, addr=address)
    await robot.connect(f"{one.tag}/service", f"{other.tag}/service")
    node = await start(one, other, route, KINDS)
    await node.wait_for_echo(KINDS)
    return node
