"""Interfaces of robots as clients of gateways see them: `/ROBOT/INTERFACE`, beside what the environment has."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeVar

from msgspec.structs import replace

from rce.control.calls.robots import RobotInterfaceName
from rce.control.calls.watching import RosAction, RosGraph, RosName, RosNode
from rce.protocol.names import parse_type

FORMS = ("Converter", "Forwarder")
T = TypeVar("T", RosName, RosAction, RosNode)


def with_robots(graph: RosGraph, interfaces: Sequence[RobotInterfaceName]) -> RosGraph:
    """Return a graph with the robots: each is a node, and what it has a topic, service or action.

    A name that the environment has too is the environment's.
    """
    shown = [each for each in interfaces if not has(graph, name_of(each))]
    if not shown:
        return graph
    topics: dict[str, RosName] = {each.name: each for each in graph.topics}
    services: dict[str, RosName] = {each.name: each for each in graph.services}
    actions: dict[str, RosAction] = {each.name: each for each in graph.actions}
    for each in shown:
        name, node, type = name_of(each), f"/{each.robot}", parse_type(each.type)
        match sort_of(each):
            case "Subscriber":
                topics[name] = RosName(name, [type.msg], 1, 0)
            case "Publisher":
                topics[name] = RosName(name, [type.msg], 0, 1)
            case "ServiceClient":
                services[name] = RosName(name, [type.srv])
            case "ActionClient":
                actions[name] = RosAction(name, [type.action], servers=[node])
    return RosGraph(
        _by_name(topics.values()),
        _by_name(services.values()),
        _by_name(actions.values()),
        _by_name([*graph.nodes, *_nodes(graph, shown)]),
    )


def _by_name(items: Iterable[T]) -> list[T]:
    return sorted(items, key=lambda each: each.name)


def _nodes(graph: RosGraph, interfaces: Sequence[RobotInterfaceName]) -> list[RosNode]:
    present = {each.name for each in graph.nodes}
    found: dict[str, RosNode] = {}
    for each in interfaces:
        node = found.setdefault(f"/{each.robot}", RosNode(f"/{each.robot}"))
        field = {"Subscriber": "publishes", "Publisher": "subscribes", "ServiceClient": "serves"}.get(sort_of(each))
        if field is not None:
            found[node.name] = replace(node, **{field: [*getattr(node, field), name_of(each)]})
    return [each for each in found.values() if each.name not in present]


def find(interfaces: Sequence[RobotInterfaceName], address: str, kind: str) -> str:
    """Return the interface that stands for an environment's of this kind at this address, as `ROBOT/TAG`, or ''."""
    for each in interfaces:
        if name_of(each) == address and f"{sort_of(each)}Interface" == kind:
            return f"{each.robot}/{each.tag}"
    return ""


def has(graph: RosGraph, address: str) -> bool:
    """Return whether an environment has a topic, service or action of this name itself."""
    names = [each.name for each in graph.topics] + [each.name for each in graph.services]
    return address in names or any(each.name == address for each in graph.actions)


def name_of(interface: RobotInterfaceName) -> str:
    """Return the name of an interface in the style of ROS."""
    return f"/{interface.robot}/{interface.tag}"


def sort_of(interface: RobotInterfaceName) -> str:
    """Return the kind of an interface without Converter or Forwarder."""
    for form in FORMS:
        if interface.kind.endswith(form):
            return interface.kind.removesuffix(form)
    return interface.kind
