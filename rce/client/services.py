"""Service clients and service providers of a robot, made by the methods of `Robot` and `Environment`."""

from __future__ import annotations

import asyncio
import inspect
import logging
import uuid
from collections.abc import Callable
from typing import Any

from rce.client.connection import Message
from rce.client.interface import Interface, Owner
from rce.client.values import decode_message, encode, encode_message
from rce.errors import RceError, TimedOut, Unavailable

log = logging.getLogger("rce.client")


class ServiceClient(Interface):
    """Interface through which the robot calls a service.

    Several calls may be under way at the same time. While the robot is offline or the service has no provider, `call`
    waits for it; calls whose socket breaks raise `Unavailable`.

    Attributes:
        tag: Name of the interface, unique within the robot.
        type_name: ROS service type.
    """

    def __init__(self, owner: Owner, tag: str, type_name: str) -> None:
        super().__init__(owner, tag, type_name)
        self._calls: dict[str, asyncio.Future[Any]] = {}

    async def call(self, request: Any, timeout: float = 10.0) -> Any:  # noqa: ASYNC109  # the error names it
        """Call the service.

        Args:
            request: The request as a dict, or bytes (CDR) with a raw interface.
            timeout: Seconds to wait for the service to be connected, and again for its response.

        Returns:
            The response as a dict, or bytes with a raw interface.

        Raises:
            NotConnected: The interface had no peer for `timeout` seconds.
            TimedOut: The service did not answer within `timeout` seconds.
            Unavailable: The socket broke during the call, which may or may not have been executed; or the robot was
                closed.
            InvalidRequest: The request cannot be expressed in JSON or does not fit the type.
            RceError: The error with which the service answered.
        """
        await self.wait_connected(timeout)
        connection = self._connection()
        if connection is None:
            raise Unavailable(f"the socket broke before {self.tag} was called")
        msg_id = uuid.uuid4().hex
        text, blobs = encode_message(self.tag, self.type_name, msg_id, request)
        response = self._calls[msg_id] = asyncio.get_running_loop().create_future()
        try:
            connection.put_message(self.tag, text, blobs)
            async with asyncio.timeout(timeout):
                return await response
        except TimeoutError:
            raise TimedOut(f"service {self.tag} ({self.type_name}) did not answer within {timeout:g} s") from None
        finally:
            del self._calls[msg_id]

    def _receive(self, message: Message) -> None:
        response = self._calls.get(message.data.msgID)
        if response is None or response.done():
            return  # the call has timed out
        if message.data.error:
            response.set_exception(RceError(message.data.error))
        else:
            response.set_result(decode_message(message.data, message.blobs))

    def _fail_call(self, error: RceError, msg_id: str) -> bool:
        response = self._calls.get(msg_id)
        if response is not None and not response.done():
            response.set_exception(error)
        return response is not None

    def _disconnected(self) -> None:
        super()._disconnected()
        self._fail_all(
            Unavailable(f"the socket broke during the call of {self.tag}: it is not known whether it was executed")
        )

    def _end(self, error: RceError | None) -> None:
        super()._end(error)
        self._fail_all(error or Unavailable("the robot has been closed"))

    def _fail_all(self, error: RceError) -> None:
        for response in self._calls.values():
            if not response.done():
                response.set_exception(error)


class ServiceProvider(Interface):
    """Interface through which the robot offers a service.

    Each call runs the handler. Its result is the response; an exception is sent to the caller as an error with its
    message. Calls run concurrently if the handler is a coroutine function. A response that is ready while the robot is
    offline is lost, and its caller times out. A server of the original has no error responses: there a failed call
    times out as well.

    Attributes:
        tag: Name of the interface, unique within the robot.
        type_name: ROS service type.
    """

    def __init__(self, owner: Owner, tag: str, type_name: str, handler: Callable[[Any], Any]) -> None:
        super().__init__(owner, tag, type_name)
        self._handler = handler
        self._tasks: set[asyncio.Task[None]] = set()

    def _receive(self, message: Message) -> None:
        request = decode_message(message.data, message.blobs)
        task = asyncio.create_task(self._answer(message.data.msgID, request), name=f"rce service {self.tag}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _end(self, error: RceError | None) -> None:
        super()._end(error)
        for task in self._tasks:
            task.cancel()

    async def _answer(self, msg_id: str, request: Any) -> None:
        try:
            result = self._handler(request)
            response = await result if inspect.isawaitable(result) else result
            text, blobs = encode_message(self.tag, self.type_name, msg_id, response)
        except RceError as error:
            self._send_error(msg_id, str(error))
            return
        except Exception as error:
            log.exception("the handler of service %s failed", self.tag)
            self._send_error(msg_id, f"{type(error).__name__}: {error}")
            return
        if self._owner.connection is not None:
            self._owner.connection.put_message(self.tag, text, blobs)

    def _send_error(self, msg_id: str, reason: str) -> None:
        connection = self._owner.connection
        if connection is None or not connection.features:
            return  # the original protocol has no error response: the caller times out
        data = {"iTag": self.tag, "type": self.type_name, "msgID": msg_id, "error": reason}
        connection.put_message(self.tag, encode({"type": "DM", "data": data}), {})
