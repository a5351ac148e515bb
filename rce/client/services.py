"""The robot's ends of services. Made by `Robot` and `Environment`, which add and connect them."""

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
    """Calls a service."""

    def __init__(self, owner: Owner, tag: str, type_name: str) -> None:
        super().__init__(owner, tag, type_name)
        self._calls: dict[str, asyncio.Future[Any]] = {}

    async def call(self, request: Any, timeout: float = 10.0) -> Any:  # noqa: ASYNC109  # the error names it
        """The response to `request`.

        Raises what the service answered, TimedOut, NotConnected, or Unavailable if the socket broke meanwhile: then it
        is not known whether the call was carried out.
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

    def received(self, message: Message) -> None:
        response = self._calls.get(message.data.msgID)
        if response is None or response.done():
            return  # too late: its caller has given up
        if message.data.error:
            response.set_exception(RceError(message.data.error))
        else:
            response.set_result(decode_message(message.data, message.blobs))

    def failed(self, error: RceError, msg_id: str) -> bool:
        response = self._calls.get(msg_id)
        if response is not None and not response.done():
            response.set_exception(error)
        return response is not None

    def lost(self) -> None:
        super().lost()
        self._fail(Unavailable(f"the socket broke while {self.tag} was called: whether that was done is not known"))

    def ended(self, error: RceError | None) -> None:
        super().ended(error)
        self._fail(error or Unavailable("the robot has been closed"))

    def _fail(self, error: RceError) -> None:
        for response in self._calls.values():
            if not response.done():
                response.set_exception(error)


class ServiceProvider(Interface):
    """Answers the calls of a service with what `handler` returns, or with the error that it raises.

    Calls run at the same time when the handler is a coroutine function.
    """

    def __init__(self, owner: Owner, tag: str, type_name: str, handler: Callable[[Any], Any]) -> None:
        super().__init__(owner, tag, type_name)
        self._handler = handler
        self._tasks: set[asyncio.Task[None]] = set()

    def received(self, message: Message) -> None:
        request = decode_message(message.data, message.blobs)
        task = asyncio.create_task(self._answer(message.data.msgID, request), name=f"rce service {self.tag}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def ended(self, error: RceError | None) -> None:
        super().ended(error)
        for task in self._tasks:
            task.cancel()

    async def _answer(self, msg_id: str, request: Any) -> None:
        try:
            result = self._handler(request)
            response = await result if inspect.isawaitable(result) else result
            text, blobs = encode_message(self.tag, self.type_name, msg_id, response)
        except RceError as error:
            self._refuse(msg_id, str(error))
            return
        except Exception as error:
            log.exception("the handler of service %s failed", self.tag)
            self._refuse(msg_id, f"{type(error).__name__}: {error}")
            return
        if self._owner.connection is not None:
            self._owner.connection.put_message(self.tag, text, blobs)

    def _refuse(self, msg_id: str, reason: str) -> None:
        connection = self._owner.connection
        if connection is None or not connection.features:
            return  # the original knows no failure: its caller waits for its own time-out
        data = {"iTag": self.tag, "type": self.type_name, "msgID": msg_id, "error": reason}
        connection.put_message(self.tag, encode({"type": "DM", "data": data}), {})
