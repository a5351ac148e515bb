"""Parameters of running nodes, set through the parameter services of ROS 2 nodes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType
from rcl_interfaces.msg import ParameterValue as RosValue
from rcl_interfaces.srv import GetParameterTypes, SetParameters
from rclpy.serialization import deserialize_message, serialize_message
from twisted.logger import Logger

from endpoints.environment.parameters import ros_form
from endpoints.environment.prepared_node import NODE as PREPARED
from endpoints.environment.ros import NODE, Ros
from endpoints.environment.ros_services import RawClient
from rce.control.calls.endpoints import ParameterSpec
from rce.errors import InvalidRequest, TimedOut
from rce.protocol.messages import ParameterValue

TIMEOUT = 2.0  # seconds for a node, and its services, to appear
ANSWER_TIMEOUT = 10.0  # seconds for a node to answer
POLL_INTERVAL = 0.02  # seconds

WRONG_TYPE = "Wrong parameter type"  # begins the reason of rclpy, which names types by numbers

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
    """Service client with message objects and futures, kept while its node exists."""

    def __init__(self, ros: Ros, kind: Any, name: str) -> None:
        """Create the client."""
        self.raw = RawClient(ros, kind, name, self._answered)
        self._ros = ros
        self._kind = kind
        self._waiting: dict[int, asyncio.Future[bytes]] = {}

    async def call(self, request: Any) -> Any:
        """Call the service; return None if the node does not offer it.

        Raises:
            TimedOut: The node offers it, but does not answer in time.
        """
        answer: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        payload = serialize_message(request)
        try:
            async with asyncio.timeout(TIMEOUT):
                while not self.raw.available():  # noqa: ASYNC110  # ROS has no event for it
                    await asyncio.sleep(POLL_INTERVAL)
        except TimeoutError:
            return None
        self._send(payload, answer)
        try:
            async with asyncio.timeout(ANSWER_TIMEOUT):
                return deserialize_message(await answer, self._kind.Response)
        except TimeoutError:
            raise TimedOut(f"it did not answer within {ANSWER_TIMEOUT:g} s") from None

    def _send(self, payload: bytes, answer: asyncio.Future[bytes]) -> None:
        self._waiting = {number: waiting for number, waiting in self._waiting.items() if not waiting.done()}
        self._waiting[self.raw.call(payload)] = answer

    def _answered(self, number: int, payload: bytes) -> None:
        waiting = self._waiting.pop(number, None)
        if waiting is not None and not waiting.done():
            waiting.set_result(payload)


class LiveParameters:
    """Sets parameters of the running nodes that declare them."""

    def __init__(self, ros: Ros, enclave: Callable[[str], str]) -> None:
        """Set parameters of nodes, of which `enclave` returns the enclave by their tags."""
        self._ros = ros
        self._enclave = enclave
        self._clients: dict[str, tuple[_Client, _Client]] = {}
        self._enclaves: set[str] = set()  # of the nodes in the ROS graph
        self._lock = asyncio.Lock()

    async def put(self, spec: ParameterSpec, starting: set[str]) -> None:
        """Set a parameter of all running nodes, or of the node that `spec` names.

        Args:
            spec: The parameter.
            starting: Tags of nodes that may not have appeared in the ROS graph yet, and are waited for.

        Raises:
            InvalidRequest: Nodes refuse the value or do not answer; the message has the reason of each.
        """
        async with self._lock:
            nodes = await self._wait_for_nodes(spec.node, starting)
            refused = await asyncio.gather(*(self._put(node, spec) for node in nodes))
        reasons = [f"node {node}: {reason}" for node, reason in zip(nodes, refused, strict=True) if reason]
        if reasons:
            raise InvalidRequest(f"parameter {spec.name} was rejected: {'; '.join(reasons)}", field="value")

    async def _wait_for_nodes(self, tag: str, starting: set[str]) -> list[str]:
        """Wait up to TIMEOUT for `starting` nodes; return the ROS names of the nodes of a tag, or of all nodes."""
        until = time.monotonic() + TIMEOUT
        while True:
            nodes = self._find(tag)
            if {self._enclave(each) for each in starting} <= self._enclaves or time.monotonic() > until:
                return nodes
            await asyncio.sleep(POLL_INTERVAL)

    def _find(self, tag: str) -> list[str]:
        """Return the ROS names of nodes and create clients for them."""
        present = [
            (f"{namespace.rstrip('/')}/{name}", place)
            for name, namespace, place in self._ros.node.get_node_names_and_namespaces_with_enclaves()
            if name not in {NODE, PREPARED}
        ]
        self._enclaves = {place for _, place in present}
        for gone in set(self._clients) - {name for name, _ in present}:
            for client in self._clients.pop(gone):
                client.raw.destroy()
        found = [name for name, place in present if not tag or place == self._enclave(tag)]
        for name in set(found) - set(self._clients):
            self._clients[name] = (
                _Client(self._ros, GetParameterTypes, f"{name}/get_parameter_types"),
                _Client(self._ros, SetParameters, f"{name}/set_parameters"),
            )
        return found

    async def _put(self, node: str, spec: ParameterSpec) -> str:
        """Return why a node has not taken the value; empty if it has, or if it declares no such parameter."""
        types_of, setter = self._clients[node]
        try:
            known = await types_of.call(GetParameterTypes.Request(names=[spec.name]))
            if known is None:
                log.info("node {node} has no parameters that can be set", node=node)
                return ""
            if not known.types or known.types[0] == ParameterType.PARAMETER_NOT_SET:
                return ""
            value = ros_value(spec.value, known.types[0])
            answer = await setter.call(SetParameters.Request(parameters=[Parameter(name=spec.name, value=value)]))
        except TimedOut as error:
            return str(error)
        if answer is None:
            return "it does not let its parameters be set"
        reason = "" if answer.results[0].successful else answer.results[0].reason or "it gave no reason"
        if reason.startswith(WRONG_TYPE):
            return f"it declares {_type_name(known.types[0])}, not {_type_name(value.type)}"
        return reason


def _type_name(number: int) -> str:
    """Return how people name a type of parameters, as `integer_array`."""
    return _fields[number][0].removesuffix("_value") if number in _fields else f"type {number}"


def ros_value(value: ParameterValue, declared: int) -> RosValue:
    """Return the value as a ROS message of the `declared` type, where that holds it.

    Integers become floating point, and an empty list, which has no type of its own, an array of that type.
    """
    form = ros_form(value)
    if value == [] and "array" in _fields.get(declared, ("", str))[0]:
        return RosValue(type=declared)
    items = form if isinstance(form, list) else [form]
    kind = type(items[0])
    if kind is int and declared in (ParameterType.PARAMETER_DOUBLE, ParameterType.PARAMETER_DOUBLE_ARRAY):
        kind = float
    number = next(
        number for number, (field, of) in _fields.items() if of is kind and ("array" in field) == isinstance(form, list)
    )
    message = RosValue(type=number)
    converted = [kind(item) for item in items]
    setattr(message, _fields[number][0], converted if isinstance(form, list) else converted[0])
    return message
