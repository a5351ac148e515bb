"""Routes between two environments: the node that takes the time is in one, the echo node in the other."""

from __future__ import annotations

from rce.bench.nodes import MeasuringNode, Place, Probe, between, start
from rce.bench.payloads import SERVICE_TYPE
from rce.client import Environment, Robot
from rce.errors import InvalidRequest

TYPES = {"string": "std_msgs/String", "bytes": "std_msgs/UInt8MultiArray"}
KINDS = [*TYPES, "service"]


async def c2c(place: Place) -> list[Probe]:
    """By the platform's own path: interfaces of the environments are connected (C2C-1 of the Rapyuta paper)."""
    other = await _environment(place, "c2c")
    node = await _connected(place.robot, place.environment, other, "c2c")
    return node.probes("c2c", KINDS, beside="n2n")


async def c2c2(place: Place) -> list[Probe]:
    """The same on two machines (C2C-2)."""
    if len(place.features) != 2:
        raise InvalidRequest("the route c2c2 needs --features ONE,OTHER: special features, each of one machine only")
    one, other = [await _environment(place, f"on_{feature}", features=[feature]) for feature in place.features]
    node = await _connected(place.robot, one, other, "c2c2")
    return node.probes("c2c2", KINDS, beside="n2n")


async def group(place: Place) -> list[Probe]:
    """By ROS 2 alone, over the network of a group."""
    one, other = [await _environment(place, f"group{number}", group=place.environment.tag) for number in range(2)]
    node = await between(one, other, "group", KINDS)
    return node.probes("group", KINDS, beside="n2n")


async def _environment(place: Place, name: str, group: str = "", features: list[str] | None = None) -> Environment:
    made = place.robot.environment(
        f"{place.environment.tag}_{name}", group=group, special_features=features or [], restart="no"
    )
    return await place.stack.enter_async_context(made)


async def _connected(robot: Robot, one: Environment, other: Environment, route: str) -> MeasuringNode:
    """What `one` publishes comes out at `other`, and back; calls of `one` are answered by `other`."""
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
    await node.found(KINDS)
    return node
