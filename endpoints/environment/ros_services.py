"""Service clients and servers with serialized requests and responses.

rclpy's services need message objects; the conversion from and to bytes costs 10 µs for small messages.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

from rclpy.client import Client
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.service import Service

from endpoints.environment.ros import Ros
from rce.errors import ConversionError, RceError, TimedOut

MAX_BATCH = 16  # messages taken of one entity before others have their turn
QOS = QoSProfile(depth=1000)  # with the default of ROS, all beyond 10 are lost
PAUSES = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2)  # seconds between attempts to send a response
NO_READER = "failed to send response"  # how the warning of rclpy begins; see RawService.answer
ServiceType = Any  # a generated service class, with Request and Response; its module is known only at run time
Header = _rclpy.rmw_request_id_t


def _object(payload: bytes, kind: type[Any], what: str) -> Any:
    try:
        return deserialize_message(payload, kind)
    except _rclpy.RMWError as error:
        raise ConversionError(f"{what} is not a serialized {kind.__module__}.{kind.__name__}: {error}") from None


class RawClient:
    """Client of a service that can have many calls in flight."""

    def __init__(self, ros: Ros, kind: ServiceType, name: str, answered: Callable[[int, bytes], None]) -> None:
        """Create the client; `answered` is called with the number of a call and its response."""
        self._ros = ros
        self._kind = kind
        self._name = name
        self._answered = answered
        self._client: Client[Any, Any] = ros.node.create_client(kind, name, qos_profile=QOS)
        self._handle = self._client.handle
        self._destroyed = False
        self._responses = ros.listen(self._take, self._handle)

    def available(self) -> bool:
        """Return True if a server of the service is there."""
        return self._client.service_is_ready()

    def server_is_here(self) -> bool:
        """Return True if the server is one of this process."""
        topic = f"rq/{self._name.lstrip('/')}Request"
        servers = self._ros.node.get_subscriptions_info_by_topic(topic, no_mangle=True)
        return bool(servers) and all(bytes(each.endpoint_gid[:12]) == self._ros.prefix for each in servers)

    def call(self, request: bytes) -> int:
        """Send a request; return the number of the call.

        Raises:
            ConversionError: The bytes are not a request of this service.
        """
        number: int = self._handle.send_request(_object(request, self._kind.Request, f"the request to {self._name}"))
        return number

    def _take(self) -> None:
        for _ in range(MAX_BATCH):
            header, response = self._handle.take_response(self._kind.Response)
            if header is None:
                return
            self._answered(header.request_id.sequence_number, serialize_message(response))
            if self._destroyed:
                return
        self._responses.again()

    def destroy(self) -> None:
        """Destroy the client."""
        self._destroyed = True
        self._ros.end(self._responses)
        self._ros.node.destroy_client(self._client)


class RawService:
    """Server of a service that answers requests in any order, at any time."""

    def __init__(
        self,
        ros: Ros,
        kind: ServiceType,
        name: str,
        requested: Callable[[Header, bytes], None],
        lost: Callable[[type[RceError], str], None],
    ) -> None:
        """Create the server.

        `requested` is called with the header of a request and the request, `lost` with the error of a response that
        could not be sent.
        """
        self._ros = ros
        self._kind = kind
        self._name = name
        self._requested = requested
        self._lost = lost
        self._destroyed = False
        self._service: Service[Any, Any] = ros.node.create_service(
            kind, name, lambda request, response: response, qos_profile=QOS
        )
        self._handle = self._service.handle
        self._requests = ros.listen(self._take, self._handle)

    def answer(self, header: Header, response: bytes) -> None:
        """Send a response.

        A request may come before ROS has discovered the reader of its response. rmw then waits for 0.1 s, and would
        drop the response with a warning. The response is sent again later.

        Raises:
            ConversionError: The bytes are not a response of this service.
        """
        answer = _object(response, self._kind.Response, f"the response of {self._name}")
        warnings.filterwarnings("error", NO_READER, RuntimeWarning)  # here, since test runners reset the filters
        self._send(answer, header, PAUSES)

    def _send(self, answer: Any, header: Header, pauses: tuple[float, ...]) -> None:
        if self._destroyed or self._sent(answer, header):
            return
        if pauses:
            self._ros.call_later(pauses[0], lambda: self._send(answer, header, pauses[1:]))
        else:
            self._lost(TimedOut, f"ROS has not found the client to which {self._name} should respond")

    def _sent(self, answer: Any, header: Header) -> bool:
        """Try to send a response; return True too if the client is gone."""
        try:
            self._handle.service_send_response(answer, header)
        except SystemError as error:  # in this form, pybind11 raises the warning
            if not isinstance(error.__cause__, RuntimeWarning):
                raise
            return False
        return True

    def _take(self) -> None:
        for _ in range(MAX_BATCH):
            request, header = self._handle.service_take_request(self._kind.Request)
            if header is None:
                return
            self._requested(header.request_id, serialize_message(request))
            if self._destroyed:
                return
        self._requests.again()

    def destroy(self) -> None:
        """Destroy the server."""
        self._destroyed = True
        self._ros.end(self._requests)
        self._ros.node.destroy_service(self._service)
