"""Uses of topics, services and actions: what a guest is connected to, and what arrives there."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

from rce.errors import RceError
from rce.protocol import messages as m
from rce.protocol.blobs import BinaryFrame, Buffer, TextFrame

Frame: TypeAlias = Buffer | BinaryFrame | TextFrame


class Arrived(NamedTuple):
    """Message for the client.

    Attributes:
        message: The data message without its value.
        value: Its value as JSON, with a closing brace after it.
        blob: Its value as a blob instead: CBOR or CDR.
    """

    message: m.DataMessage
    value: Buffer
    blob: Buffer | None


class Sealed(tuple[Frame, ...]):
    """Frames in the gateway's protocol, which are sent as they are."""


class Kind(NamedTuple):
    """Kinds of the two interfaces of a use; `own` without Converter or Forwarder."""

    environment: m.InterfaceType
    own: str


SUBSCRIBE = Kind("SubscriberInterface", "Publisher")
PUBLISH = Kind("PublisherInterface", "Subscriber")
CALL = Kind("ServiceClientInterface", "ServiceProvider")
SERVE = Kind("ServiceProviderInterface", "ServiceClient")
ASK = Kind("ActionClientInterface", "ActionProvider")
ACT = Kind("ActionProviderInterface", "ActionClient")


class Use:
    """Use of a topic, service or action by a guest.

    Attributes:
        tag: Tag of the guest's interface.
        type: Type, as it was asked for.
        robot: The interface of a robot that is used, as `ROBOT/TAG`; empty for what the environment has.
        ready: Done when it is connected; has the error if it could not be made.
        ended: Has the error once the use could not be made, or came to an end without the client's doing.
    """

    def __init__(
        self,
        tag: str,
        address: str,
        type: str,
        receive: Callable[[Arrived], Sequence[Frame]],
        failed: Callable[[str, RceError], None],
    ) -> None:
        self.tag = tag
        self.address = address
        self.type = type
        self.robot = ""
        self.receive = receive
        self.failed = failed
        self.ready: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        for future in (self.ready, self.ended):
            future.add_done_callback(lambda done: done.cancelled() or done.exception())

    def end(self, error: RceError) -> None:
        """End the use with an error."""
        for future in (self.ready, self.ended):
            if not future.done():
                future.set_exception(error)

    def cancel(self) -> None:
        """Forget the use: its client has left."""
        self.ready.cancel()
        self.ended.cancel()

    def on_end(self, handle: Callable[[RceError], None]) -> None:
        """Call a function with the error once the use has ended."""

        def done(ended: asyncio.Future[None]) -> None:
            if not ended.cancelled() and isinstance(error := ended.exception(), RceError):
                handle(error)

        self.ended.add_done_callback(done)
