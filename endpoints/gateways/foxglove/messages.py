"""Messages of the protocol: JSON of clients, and binary frames in both directions (little endian)."""

from __future__ import annotations

import struct
import time
from typing import Any, NamedTuple

import msgspec
from msgspec import Struct

from rce.errors import InvalidRequest
from rce.protocol.blobs import BinaryFrame, Buffer

Id = int
MESSAGE, SERVICE = 1, 2  # opcodes of clients
MESSAGE_DATA, SERVICE_RESPONSE, ASSET = 1, 3, 4  # opcodes of the server
_MESSAGE, _CALL, _DATA = struct.Struct("<I"), struct.Struct("<III"), struct.Struct("<BIQ")


class Subscription(Struct, frozen=True):
    """Subscription of a channel."""

    id: Id
    channelId: Id


class Subscribe(Struct, frozen=True, tag_field="op", tag="subscribe"):
    """Subscribe to channels."""

    subscriptions: list[Subscription]


class Unsubscribe(Struct, frozen=True, tag_field="op", tag="unsubscribe"):
    """End subscriptions."""

    subscriptionIds: list[Id]


class ClientChannel(Struct, frozen=True):
    """Channel on which a client publishes."""

    id: Id
    topic: str
    encoding: str
    schemaName: str


class Advertise(Struct, frozen=True, tag_field="op", tag="advertise"):
    """Begin to publish."""

    channels: list[ClientChannel]


class Unadvertise(Struct, frozen=True, tag_field="op", tag="unadvertise"):
    """Publish no more."""

    channelIds: list[Id]


class GetParameters(Struct, frozen=True, tag_field="op", tag="getParameters"):
    """Read parameters; with no names all of them."""

    parameterNames: list[str]
    id: str | None = None


class Parameter(Struct, frozen=True):
    """Parameter, without a value if it is to be deleted."""

    name: str
    value: Any = None
    type: str | None = None


class SetParameters(Struct, frozen=True, tag_field="op", tag="setParameters"):
    """Set parameters; with an id their values are sent back."""

    parameters: list[Parameter]
    id: str | None = None


class SubscribeParameters(Struct, frozen=True, tag_field="op", tag="subscribeParameterUpdates"):
    """Ask for the changes of parameters."""

    parameterNames: list[str]


class UnsubscribeParameters(Struct, frozen=True, tag_field="op", tag="unsubscribeParameterUpdates"):
    """Ask for the changes of parameters no more."""

    parameterNames: list[str]


class SubscribeGraph(Struct, frozen=True, tag_field="op", tag="subscribeConnectionGraph"):
    """Ask for the graph of topics and nodes, and its changes."""


class UnsubscribeGraph(Struct, frozen=True, tag_field="op", tag="unsubscribeConnectionGraph"):
    """Ask for the graph no more."""


class FetchAsset(Struct, frozen=True, tag_field="op", tag="fetchAsset"):
    """Fetch a file."""

    uri: str
    requestId: Id


class ClientMessage(NamedTuple):
    """Message of a client on one of its channels."""

    channel: int
    payload: memoryview


class ServiceRequest(NamedTuple):
    """Call of a service."""

    service: int
    call: int
    encoding: str
    payload: memoryview


AnyMessage = (
    Subscribe
    | Unsubscribe
    | Advertise
    | Unadvertise
    | GetParameters
    | SetParameters
    | SubscribeParameters
    | UnsubscribeParameters
    | SubscribeGraph
    | UnsubscribeGraph
    | FetchAsset
)
_decoder: msgspec.json.Decoder[AnyMessage] = msgspec.json.Decoder(AnyMessage)


def decode(payload: bytes) -> AnyMessage:
    """Decode a text message; raises InvalidRequest."""
    try:
        return _decoder.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InvalidRequest(f"the message is not one of the Foxglove protocol: {str(error)[:300]}") from None


def decode_binary(payload: bytes) -> ClientMessage | ServiceRequest:
    """Decode a binary message; raises InvalidRequest."""
    view = memoryview(payload)
    try:
        if view[0] == MESSAGE:
            return ClientMessage(_MESSAGE.unpack_from(view, 1)[0], view[5:])
        if view[0] == SERVICE:
            service, call, length = _CALL.unpack_from(view, 1)
            end = 13 + length
            if end > len(view):
                raise InvalidRequest("the name of the encoding ends after the message")
            return ServiceRequest(service, call, str(view[13:end], "utf-8"), view[end:])
    except (struct.error, IndexError, UnicodeDecodeError):
        raise InvalidRequest(f"the binary message of {len(view)} bytes is cut off or malformed") from None
    raise InvalidRequest(f"a binary message with opcode {view[0]} is not understood: it must be 1 or 2")


def message_data(subscription: int, payload: Buffer) -> BinaryFrame:
    """Return the frame of a message, with the present time as its log time."""
    return BinaryFrame(_DATA.pack(MESSAGE_DATA, subscription, time.time_ns()), memoryview(payload))


def service_response(request: ServiceRequest, payload: Buffer) -> BinaryFrame:
    """Return the frame of a response."""
    encoding = request.encoding.encode()
    head = bytes([SERVICE_RESPONSE]) + _CALL.pack(request.service, request.call, len(encoding)) + encoding
    return BinaryFrame(head, memoryview(payload))


def asset_error(request: int, error: str) -> BinaryFrame:
    """Return the frame of an asset that cannot be had."""
    text = error.encode()
    return BinaryFrame(struct.pack("<BIBI", ASSET, request, 1, len(text)), memoryview(text))


def text(**fields: object) -> bytes:
    """Return a message as JSON."""
    return msgspec.json.encode(fields)
