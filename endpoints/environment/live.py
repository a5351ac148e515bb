"""Parameters of running nodes, set through the services that ROS 2 nodes have for it."""

from __future__ import annotations

import asyncio
import time
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType
from rcl_interfaces.msg import ParameterValue as RosValue
from rcl_interfaces.srv import GetParameterTypes, SetParameters
from rclpy.serialization import deserialize_message, serialize_message
from twisted.logger import Logger

from endpoints.environment.arguments import enclave
from endpoints.environment.ros import NODE, RosThread
from endpoints.environment.ros_services import RawClient
from rce.calls.endpoints import ParameterSpec
from rce.errors import InvalidRequest
from rce.messages import ParameterValue

PATIENCE = 2.0  # seconds for the answer of a node, which may be busy, or not yet up
LOOK = 0.02

log = Logger()
_fields = {
    ParameterType.PARAMETER_BOOL: ("bool_value", bool),
    ParameterType.PARAMETER_INTEGER: ("integer_value", int),
    ParameterType.PARAMETER_DOUBLE: ("double_value", float),
    ParameterType.PARAMETER_STRING: ("string_value", str),
    ParameterType.PARAMETER_BOOL_ARRAY: ("bool_array_value", bool),
    ParameterType.PARAMETER_INTEGER_ARRAY: ("integer_array_value", int),
    ParameterType.PARAMETER_DOUBLE_ARRAY: ("double_array_value", float),
    ParameterType.PARAMETER_STRING_ARRAY: ("string_array_value", str),
}


class _Client:
    """A service client with objects and futures, kept while its node lives."""

    def __init__(self, ros: RosThread, kind: Any, name: str) -> None:
        """In the ROS thread."""
        self.raw = RawClient(ros, kind, name, self._answered)
        self._ros = ros
        self._kind = kind
        self._waiting: dict[int, asyncio.Future[bytes]] = {}

    async def ask(self, request: Any) -> Any:
        """None when there is no answer in time."""
        answer: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        payload = serialize_message(request)
        try:
            async with asyncio.timeout(PATIENCE):
                while not await self._ros.run(self.raw.available):  # noqa: ASYNC110  # nothing announces it
                    await asyncio.sleep(LOOK)
                self._ros.post(lambda: self._ask(payload, answer))
                return deserialize_message(await answer, self._kind.Response)
        except TimeoutError:
            return None

    def _ask(self, payload: bytes, answer: asyncio.Future[bytes]) -> None:
        self._waiting = {number: waiting for number, waiting in self._waiting.items() if not waiting.done()}
        self._waiting[self.raw.ask(payload)] = answer

    def _answered(self, number: int, payload: bytes) -> None:
        waiting = self._waiting.pop(number, None)
        if waiting is not None:
            self._ros.deliver(lambda: None if waiting.done() else waiting.set_result(payload))


class LiveParameters:
    """Sets parameters on the nodes of this environment that declare them."""

    def __init__(self, ros: RosThread) -> None:
        self._ros = ros
        self._clients: dict[str, tuple[_Client, _Client]] = {}
        self._enclaves: set[str] = set()  # of nodes that ROS knows
        self._one = asyncio.Lock()

    async def put(self, spec: ParameterSpec, young: set[str]) -> None:
        """On all running nodes, or those of one tag; those with tags in `young` may still have to appear.

        InvalidRequest with the reasons of those that refuse the value.
        """
        async with self._one:
            nodes = await self._appeared(spec.node, young)
            refused = await asyncio.gather(*(self._put(node, spec) for node in nodes))
        reasons = [reason for reason in refused if reason]
        if reasons:
            raise InvalidRequest(f"parameter {spec.name} was refused: {'; '.join(reasons)}", field="value")

    async def _appeared(self, tag: str, young: set[str]) -> list[str]:
        """The ROS names of the nodes of a tag, or of all, when the young ones are there or have had their time."""
        until = time.monotonic() + PATIENCE
        while True:
            nodes = await self._ros.run(lambda: self._find(tag))
            if {enclave(each) for each in young} <= self._enclaves or time.monotonic() > until:
                return nodes
            await asyncio.sleep(LOOK)

    def _find(self, tag: str) -> list[str]:
        """The ROS names of nodes, with clients for them. In the ROS thread."""
        there = [
            (f"{namespace.rstrip('/')}/{name}", place)
            for name, namespace, place in self._ros.node.get_node_names_and_namespaces_with_enclaves()
            if name != NODE
        ]
        self._enclaves = {place for _, place in there}
        for gone in set(self._clients) - {name for name, _ in there}:
            for client in self._clients.pop(gone):
                self._ros.unwatch(client.raw)
        found = [name for name, place in there if not tag or place == enclave(tag)]
        for name in set(found) - set(self._clients):
            self._clients[name] = (
                _Client(self._ros, GetParameterTypes, f"{name}/get_parameter_types"),
                _Client(self._ros, SetParameters, f"{name}/set_parameters"),
            )
        return found

    async def _put(self, node: str, spec: ParameterSpec) -> str:
        """Why the node refuses the value; empty if it took it, does not declare it, or does not answer."""
        types_of, setter = self._clients[node]
        known = await types_of.ask(GetParameterTypes.Request(names=[spec.name]))
        if known is None:
            log.warn("node {node} does not answer about its parameters: {name} not set", node=node, name=spec.name)
            return ""
        if not known.types or known.types[0] == ParameterType.PARAMETER_NOT_SET:
            return ""
        value = ros_value(spec.value, known.types[0])
        answer = await setter.ask(SetParameters.Request(parameters=[Parameter(name=spec.name, value=value)]))
        if answer is None or answer.results[0].successful:
            return ""
        return f"node {node}: {answer.results[0].reason}"


def ros_value(value: ParameterValue, declared: int) -> RosValue:
    """The value as ROS's message; integers become what is `declared` if that is floating point."""
    items = value if isinstance(value, list) else [value]
    kind = type(items[0])
    if kind is int and declared in (ParameterType.PARAMETER_DOUBLE, ParameterType.PARAMETER_DOUBLE_ARRAY):
        kind = float
    number = next(
        number
        for number, (field, of) in _fields.items()
        if of is kind and ("array" in field) == isinstance(value, list)
    )
    message = RosValue(type=number)
    converted = [kind(item) for item in items]
    setattr(message, _fields[number][0], converted if isinstance(value, list) else converted[0])
    return message
