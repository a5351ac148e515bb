"""The services of rosapi, which the gateway answers itself from the ROS graph, the type definitions and parameters."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from typing import Any

import msgspec

from endpoints.gateways.asker import Asker
from endpoints.gateways.definitions import message_text, typedefs
from endpoints.gateways.guest import Guest
from endpoints.gateways.parameters import Parameters
from rce.control.calls.robots import Sort
from rce.control.calls.watching import RosAction, RosGraph, RosName, RosNode
from rce.errors import MALFORMED, InvalidRequest, NotFound, RceError
from rce.protocol.names import TypeName, parse_type
from rce.value_count import check_value_count

PREFIX = "/rosapi/"
Arguments = dict[str, Any]
Answer = dict[str, Any]


class Rosapi:
    """Services of rosapi for one client.

    Args:
        guest: The client's guest.
    """

    def __init__(self, guest: Guest) -> None:
        self._guest = guest
        self._parameters = Parameters(guest.view.present_graph, Asker(guest))
        self._by_graph: dict[str, Callable[[RosGraph, Arguments], Answer]] = _BY_GRAPH
        self._others: dict[str, Callable[[Arguments], Awaitable[Answer]]] = {
            "topics_and_raw_types": self._raw_types,
            "message_details": lambda args: self._details(args, "msg", ""),
            "service_request_details": lambda args: self._details(args, "srv", "_Request"),
            "service_response_details": lambda args: self._details(args, "srv", "_Response"),
            "action_goal_details": lambda args: self._details(args, "action", "_Goal"),
            "action_result_details": lambda args: self._details(args, "action", "_Result"),
            "action_feedback_details": lambda args: self._details(args, "action", "_Feedback"),
            "get_param": self._get_param,
            "set_param": self._set_param,
            "has_param": self._has_param,
            "delete_param": self._delete_param,
            "get_param_names": self._param_names,
            "get_time": _time,
            "get_ros_version": _version,
        }

    def has(self, service: str) -> bool:
        """Return True if this is a service of rosapi."""
        return service.startswith(PREFIX)

    async def call(self, service: str, args: bytes) -> Answer:
        """Return the response of a service.

        Raises:
            NotFound: rosapi has no such service.
            RceError: The call failed.
        """
        name = service.removeprefix(PREFIX)
        check_value_count(args, service)
        try:
            values = msgspec.json.decode(args or b"{}")
        except MALFORMED as error:
            raise InvalidRequest(f"{service}: {error}") from None
        arguments: Arguments = values if isinstance(values, dict) else _named(name, values)
        if name in self._by_graph:
            return self._by_graph[name](await self._guest.view.graph(), arguments)
        if name in self._others:
            return await self._others[name](arguments)
        raise NotFound(f"rosapi has no service {name[:80]}")

    # --- types --------------------------------------------------------------------------------------------------------

    async def _raw_types(self, _: Arguments) -> Answer:
        topics = (await self._guest.view.graph()).topics
        texts = dict[str, str]()
        for type in {each.types[0] for each in topics}:
            try:
                texts[type] = message_text(await self._guest.view.definitions(type, "msg"), parse_type(type).msg)
            except RceError:
                texts[type] = ""  # as rosapi does
        types = [each.types[0] for each in topics]
        return {
            "topics": [each.name for each in topics],
            "types": types,
            "typedefs_full_text": [texts[each] for each in types],
        }

    async def _details(self, args: Arguments, sort: Sort, part: str) -> Answer:
        name = parse_type(_text(args, "type"))
        full = {"msg": name.msg, "srv": name.srv, "action": name.action}[sort] + part
        return {"typedefs": typedefs(await self._guest.view.definitions(str(name), sort), full)}

    # --- parameters ---------------------------------------------------------------------------------------------------

    async def _get_param(self, args: Arguments) -> Answer:
        await self._guest.changes.settle()
        try:
            value = await self._parameters.get(_text(args, "name"))
        except RceError as error:
            return {"value": _as_json(args.get("default_value", "")), "successful": False, "reason": str(error)}
        return {"value": msgspec.json.encode(value).decode(), "successful": True, "reason": ""}

    async def _set_param(self, args: Arguments) -> Answer:
        text = _text(args, "value")
        check_value_count(text.encode(), "the value")
        try:
            value = msgspec.json.decode(text)
        except MALFORMED:
            value = text
        return await self._set(_text(args, "name"), value)

    async def _delete_param(self, args: Arguments) -> Answer:
        return await self._set(_text(args, "name"), None)

    async def _set(self, name: str, value: Any) -> Answer:
        try:
            async with self._guest.changes.carry_out():
                await self._parameters.set(name, value)
        except RceError as error:
            return {"successful": False, "reason": str(error)}
        return {"successful": True, "reason": ""}

    async def _has_param(self, args: Arguments) -> Answer:
        await self._guest.changes.settle()
        try:
            await self._parameters.get(_text(args, "name"))
        except RceError:
            return {"exists": False}
        return {"exists": True}

    async def _param_names(self, _: Arguments) -> Answer:
        await self._guest.changes.settle()
        return {"names": await self._parameters.names()}


async def _time(_: Arguments) -> Answer:
    seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
    return {"time": {"sec": seconds, "nanosec": nanoseconds}}


async def _version(_: Arguments) -> Answer:
    return {"version": 2, "distro": "kilted"}


def _text(args: Arguments, name: str) -> str:
    value = args.get(name)
    if not isinstance(value, str):
        raise InvalidRequest(f"the argument {name} must be a string", field=name)
    return value


def _as_json(text: Any) -> str:
    """Return a text that is JSON as it is, and any other as a JSON string: clients parse the values of parameters."""
    try:
        msgspec.json.decode(text)
    except (TypeError, *MALFORMED):
        return msgspec.json.encode(text).decode()
    return str(text)


_FIRST = {"set_param": ("name", "value"), "get_param": ("name", "default_value")}


def _named(service: str, values: Any) -> Arguments:
    """Return arguments that were given as a list."""
    if not isinstance(values, list):
        return {}
    usual = ("topic" if service in ("topic_type", "publishers", "subscribers") else "",)
    names = _FIRST.get(service, usual if usual[0] else ("node", "service", "type", "name", "action"))
    return dict(zip(names, values, strict=False)) if service in _FIRST else dict.fromkeys(names, *values[:1])


# --- the graph --------------------------------------------------------------------------------------------------------


def _of_type(every: list[RosName], type: str) -> list[str]:
    wanted = parse_type(type)
    return [each.name for each in every if any(_is_type(own, wanted) for own in each.types)]


def _is_type(type: str, wanted: TypeName) -> bool:
    try:
        return parse_type(type) == wanted
    except InvalidRequest:  # nodes may have given it any name
        return False


def _type_of(every: list[RosName] | list[RosAction], name: str) -> str:
    return next((each.types[0] for each in every if each.name == _absolute(name)), "")


def _absolute(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


def _node_details(graph: RosGraph, args: Arguments) -> Answer:
    name = _absolute(_text(args, "node"))
    node = next((each for each in graph.nodes if each.name == name), RosNode(name))
    return {"subscribing": node.subscribes, "publishing": node.publishes, "services": node.serves}


def _serving(graph: RosGraph, service: str) -> list[str]:
    return [each.name for each in graph.nodes if _absolute(service) in each.serves]


_BY_GRAPH: dict[str, Callable[[RosGraph, Arguments], Answer]] = {
    "topics": lambda graph, _: {
        "topics": [each.name for each in graph.topics],
        "types": [each.types[0] for each in graph.topics],
    },
    "topics_for_type": lambda graph, args: {"topics": _of_type(graph.topics, _text(args, "type"))},
    "services": lambda graph, _: {"services": [each.name for each in graph.services]},
    "services_for_type": lambda graph, args: {"services": _of_type(graph.services, _text(args, "type"))},
    "nodes": lambda graph, _: {"nodes": [each.name for each in graph.nodes]},
    "node_details": _node_details,
    "action_servers": lambda graph, _: {"action_servers": [each.name for each in graph.actions if each.servers]},
    "topic_type": lambda graph, args: {"type": _type_of(graph.topics, _text(args, "topic"))},
    "service_type": lambda graph, args: {"type": _type_of(graph.services, _text(args, "service"))},
    "action_type": lambda graph, args: {"type": _type_of(graph.actions, _text(args, "action"))},
    "publishers": lambda graph, args: {
        "publishers": [each.name for each in graph.nodes if _absolute(_text(args, "topic")) in each.publishes]
    },
    "subscribers": lambda graph, args: {
        "subscribers": [each.name for each in graph.nodes if _absolute(_text(args, "topic")) in each.subscribes]
    },
    "service_providers": lambda graph, args: {"providers": _serving(graph, _text(args, "service"))},
    "service_node": lambda graph, args: {"node": next(iter(_serving(graph, _text(args, "service"))), "")},
    "interfaces": lambda graph, _: {
        "interfaces": sorted(
            {type for each in (*graph.topics, *graph.services) for type in each.types}
            | {type for each in graph.actions for type in each.types}
        )
    },
}
