"""ROS parameters of the nodes of an environment, by the services that every node has."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection
from typing import Any, Protocol

import msgspec

from endpoints.gateways.graphs import FRESH
from rce.control.calls.watching import RosGraph
from rce.errors import InvalidRequest, NotFound, RceError

KINDS = ("bool", "integer", "double", "string", "byte_array", "bool_array", "integer_array", "double_array",
         "string_array")  # fmt: skip
"""Types of `rcl_interfaces/ParameterType` from 1 on; the field is this and `_value`."""


class Ask(Protocol):
    """Calls a service of the environment."""

    async def __call__(self, service: str, type: str, args: bytes) -> bytes:
        """Return the response as JSON; raises RceError."""


class Parameters:
    """Parameters by `NODE:NAME`.

    Args:
        graph: Returns the ROS graph, at most the given seconds old.
        ask: Calls a service.
    """

    def __init__(self, graph: Callable[[float], Awaitable[RosGraph]], ask: Ask) -> None:
        self._graph = graph
        self._ask = ask

    async def get(self, name: str) -> Any:
        """Return the value of a parameter.

        Raises:
            NotFound: It is not set, or there is no such node.
            RceError: The node does not answer.
        """
        node, parameter = _split(name)
        answer = await self._call(node, "get_parameters", "GetParameters", names=[parameter])
        value = _only(answer["values"] or [{}], node)
        if not value.get("type"):
            raise NotFound(f"parameter {name[:200]} is not set", field="name")
        return value_of(value)

    async def set(self, name: str, value: Any) -> None:
        """Set a parameter; None deletes it.

        Raises:
            InvalidRequest: The node refuses it.
            NotFound: There is no such node.
            RceError: The node does not answer.
        """
        node, parameter = _split(name)
        change = {"name": parameter, "value": _typed(value)}
        answer = await self._call(node, "set_parameters", "SetParameters", parameters=[change])
        result = _only(answer["results"], node)
        if not result["successful"]:
            raise InvalidRequest(result["reason"] or f"{name} was refused")

    async def values(self, names: Collection[str] = ()) -> dict[str, Any]:
        """Return the values of these parameters, or of all; those that are not set or cannot be had are left out."""
        by_node = dict[str, list[str]]()
        for name in names or await self.names():
            node, parameter = _split(name)
            by_node.setdefault(node, []).append(parameter)
        found = await asyncio.gather(*(self._values_of(node, each) for node, each in by_node.items()))
        return {name: value for values in found for name, value in values.items()}

    async def _values_of(self, node: str, names: list[str]) -> dict[str, Any]:
        try:
            answer = await self._call(node, "get_parameters", "GetParameters", names=names)
        except RceError:
            return {}
        pairs = zip(names, answer["values"], strict=False)
        return {f"{node}:{name}": value_of(value) for name, value in pairs if value.get("type")}

    async def names(self) -> list[str]:
        """Return the names of all parameters; those of nodes that do not answer are left out."""
        graph = await self._graph(FRESH)
        serving = [each.name for each in graph.nodes if f"{each.name}/list_parameters" in each.serves]
        found = await asyncio.gather(*map(self._names_of, serving))
        return sorted(name for names in found for name in names)

    async def _names_of(self, node: str) -> list[str]:
        try:
            answer = await self._call(node, "list_parameters", "ListParameters")
        except RceError:
            return []
        return [f"{node}:{name}" for name in answer["result"]["names"]]

    async def _call(self, node: str, service: str, type: str, **args: Any) -> Any:
        await self._check(f"{node}/{service}", node)
        answer = await self._ask(f"{node}/{service}", f"rcl_interfaces/{type}", msgspec.json.encode(args))
        return msgspec.json.decode(answer)

    async def _check(self, service: str, node: str) -> None:
        """Raise NotFound if a node does not serve a service: a call would wait for it to appear."""
        for age in (FRESH, 0.0):
            if any(each.name == service for each in (await self._graph(age)).services):
                return
        raise NotFound(f"there is no node {node[:200]} with parameters", field="name")


def _split(name: str) -> tuple[str, str]:
    node, colon, parameter = name.partition(":")
    if not colon or not parameter or not node.strip("/"):
        raise InvalidRequest(f"{name[:200]!r} is not a parameter: write NODE:NAME, as /camera:rate", field="name")
    return "/" + node.lstrip("/"), parameter


def _only(items: list[Any], node: str) -> Any:
    if len(items) != 1:
        raise RceError(f"node {node[:200]} answered for {len(items)} parameters when it was asked for one")
    return items[0]


def value_of(value: dict[str, Any]) -> Any:
    """Return the value of a `rcl_interfaces/ParameterValue`, or None if it is not set."""
    kind = value.get("type", 0)
    return value[f"{KINDS[kind - 1]}_value"] if 1 <= kind <= len(KINDS) else None


def _typed(value: Any) -> dict[str, Any]:
    if value is None:
        return {"type": 0}
    kind = _kind(value)
    return {"type": KINDS.index(kind) + 1, f"{kind}_value": value}


def _kind(value: Any) -> str:
    if isinstance(value, bool):
        return "bool"
    if isinstance(value, int | float):
        return "integer" if isinstance(value, int) else "double"
    if isinstance(value, str):
        return "string"
    if isinstance(value, list):
        kinds = {_kind(each) for each in value if not isinstance(each, list)}
        if len(kinds) == 1:
            return f"{kinds.pop()}_array"
        if kinds == {"integer", "double"}:
            return "double_array"
    raise InvalidRequest("a parameter is a bool, number or string, or a list of one of these", field="value")
