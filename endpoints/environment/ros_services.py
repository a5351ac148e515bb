"""Service clients and servers with serialized requests and responses. All methods run in the ROS thread.

rclpy's services need message objects; the conversion from and to bytes costs 10 µs for small messages.
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

MAX_BATCH = 16  # messages taken of one entity before others have their turn
QOS = QoSProfile(depth=1000)  # with the default of ROS, all beyond 10 are lost
ServiceType = Any  # a generated service class, with Request and Response; its module is known only at run time
Header = _rclpy.rmw_request_id_t


def _object(payload: bytes, kind: type[Any], what: str) -> Any:
    try:
        return deserialize_message(payload, kind)
    except _rclpy.RMWError as error:
        raise ConversionError(f"{what} is not a serialized {kind.__module__}.{kind.__name__}: {error}") from None


class RawClient:
    """Client of a service that can have many calls in flight."""

    subscriptions = services = events = 0
    clients = 1

    def __init__(self, ros: RosThread, kind: ServiceType, name: str, answered: Callable[[int, bytes], None]) -> None:
        """Create the client; `answered` is called with the number of a call and its response."""
        self._ros = ros
        self._kind = kind
        self._name = name
        self._answered = answered
        self._client: Client[Any, Any] = ros.node.create_client(kind, name, qos_profile=QOS)
        self._handle = self._client.handle
        ros.add_waitable(self)

    def available(self) -> bool:
        """Return True if a server of the service is there."""
        return self._client.service_is_ready()

    def call(self, request: bytes) -> int:
        """Send a request; return the number of the call.

        Raises:
            ConversionError: The bytes are not a request of this service.
        """
        number: int = self._handle.send_request(_object(request, self._kind.Request, f"the request to {self._name}"))
        return number

    def add(self, wait_set: _rclpy.WaitSet) -> None:
        """Add the client to the wait set."""
        self._index = wait_set.add_client(self._handle)

    def take(self, wait_set: _rclpy.WaitSet) -> None:
        """Take the responses that have come."""
        if not wait_set.is_ready("client", self._index):
            return
        for _ in range(MAX_BATCH):
            header, response = self._handle.take_response(self._kind.Response)
            if header is None:
                return
            self._answered(header.request_id.sequence_number, serialize_message(response))

    def destroy(self) -> None:
        """Destroy the client."""
        self._ros.node.destroy_client(self._client)


class RawService:
    """Server of a service that answers requests in any order, at any time."""

    subscriptions = clients = events = 0
    services = 1

    def __init__(
        self, ros: RosThread, kind: ServiceType, name: str, requested: Callable[[Header, bytes], None]
    ) -> None:
        """Create the server; `requested` is called with the header of a request and the request."""
        self._ros = ros
        self._kind = kind
        self._name = name
        self._requested = requested
        self._service: Service[Any, Any] = ros.node.create_service(
            kind, name, lambda request, response: response, qos_profile=QOS
        )
        self._handle = self._service.handle
        ros.add_waitable(self)

    def answer(self, header: Header, response: bytes) -> None:
        """Send a response.

        Raises:
            ConversionError: The bytes are not a response of this service.
        """
        answer = _object(response, self._kind.Response, f"the response of {self._name}")
        self._handle.service_send_response(answer, header)

    def add(self, wait_set: _rclpy.WaitSet) -> None:
        """Add the server to the wait set."""
        self._index = wait_set.add_service(self._handle)

    def take(self, wait_set: _rclpy.WaitSet) -> None:
        """Take the requests that have come."""
        if not wait_set.is_ready("service", self._index):
            return
        for _ in range(MAX_BATCH):
            request, header = self._handle.service_take_request(self._kind.Request)
            if header is None:
                return
            self._requested(header.request_id, serialize_message(request))

    def destroy(self) -> None:
        """Destroy the server."""
        self._ros.node.destroy_service(self._service)
