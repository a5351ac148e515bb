"""Service clients and servers with serialized requests and responses. All methods run in the ROS thread.

rclpy's services want objects; to make them from bytes and back costs 10 µs for small ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.client import Client
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.service import Service

from endpoints.environment.ros import RosThread
from rce.errors import ConversionError

AT_ONCE = 16
PATIENT = QoSProfile(depth=1000)  # ROS's default loses what goes beyond 10
ServiceType = Any  # a generated service class, with Request and Response; its module is known only at run time
Header = _rclpy.rmw_request_id_t


def _object(payload: bytes, kind: type[Any], what: str) -> Any:
    try:
        return deserialize_message(payload, kind)
    except _rclpy.RMWError as error:
        raise ConversionError(f"{what} is not a serialized {kind.__module__}.{kind.__name__}: {error}") from None


class RawClient:
    """Calls a service; many calls may be in flight."""

    subscriptions = services = events = 0
    clients = 1

    def __init__(self, ros: RosThread, kind: ServiceType, name: str, answered: Callable[[int, bytes], None]) -> None:
        self._ros = ros
        self._kind = kind
        self._name = name
        self._answered = answered
        self._client: Client[Any, Any] = ros.node.create_client(kind, name, qos_profile=PATIENT)
        self._handle = self._client.handle
        ros.watch(self)

    def available(self) -> bool:
        return self._client.service_is_ready()

    def ask(self, request: bytes) -> int:
        """Send a request; `answered` gets the number returned here with the response. ConversionError."""
        number: int = self._handle.send_request(_object(request, self._kind.Request, f"the request to {self._name}"))
        return number

    def add(self, wait_set: _rclpy.WaitSet) -> None:
        self._index = wait_set.add_client(self._handle)

    def take(self, wait_set: _rclpy.WaitSet) -> None:
        if not wait_set.is_ready("client", self._index):
            return
        for _ in range(AT_ONCE):
            header, response = self._handle.take_response(self._kind.Response)
            if header is None:
                return
            self._answered(header.request_id.sequence_number, serialize_message(response))

    def destroy(self) -> None:
        self._ros.node.destroy_client(self._client)


class RawService:
    """Offers a service; each request is answered whenever its answer is there."""

    subscriptions = clients = events = 0
    services = 1

    def __init__(self, ros: RosThread, kind: ServiceType, name: str, asked: Callable[[Header, bytes], None]) -> None:
        self._ros = ros
        self._kind = kind
        self._name = name
        self._asked = asked
        self._service: Service[Any, Any] = ros.node.create_service(
            kind, name, lambda request, response: response, qos_profile=PATIENT
        )
        self._handle = self._service.handle
        ros.watch(self)

    def answer(self, header: Header, response: bytes) -> None:
        """ConversionError if `response` is not one of this service."""
        answer = _object(response, self._kind.Response, f"the response of {self._name}")
        self._handle.service_send_response(answer, header)

    def add(self, wait_set: _rclpy.WaitSet) -> None:
        self._index = wait_set.add_service(self._handle)

    def take(self, wait_set: _rclpy.WaitSet) -> None:
        if not wait_set.is_ready("service", self._index):
            return
        for _ in range(AT_ONCE):
            request, header = self._handle.service_take_request(self._kind.Request)
            if header is None:
                return
            self._asked(header.request_id, serialize_message(request))

    def destroy(self) -> None:
        self._ros.node.destroy_service(self._service)
