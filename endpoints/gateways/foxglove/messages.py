"""Messages of the protocol: JSON of clients, and binary frames in both directions (little endian)."""

from __future__ import annotations

import math
import struct
from time import time_ns
from typing import Annotated, Any, NamedTuple

import msgspec
from msgspec import Meta, Struct

from rce.bag.playback import PlaybackState, Status
from rce.errors import InvalidRequest
from rce.protocol.blobs import BinaryFrame, Buffer
from rce.value_count import check_value_count

Id = Annotated[int, Meta(ge=0, le=2**32 - 1)]  # it is sent back as 32 bits
Many = Meta(max_length=10_000)  # items of one message
MESSAGE, SERVICE, PLAYBACK = 1, 2, 3  # opcodes of clients
MESSAGE_DATA, TIME, SERVICE_RESPONSE, ASSET, PLAYBACK_STATE = 1, 2, 3, 4, 5  # opcodes of the server
STATUSES: dict[Status, int] = {"playing": 0, "paused": 1, "buffering": 2, "ended": 3}
_COMMAND, _STATE = struct.Struct("<BfBQI"), struct.Struct("<BBQfBI")
_MESSAGE, _CALL, _DATA = struct.Struct("<I"), struct.Struct("<III"), struct.Struct("<BIQ")


class Subscription(Struct, frozen=True):
    """Subscription of a channel."""

    id: Id
    channelId: Id


class Subscribe(Struct, frozen=True, tag_field="op", tag="subscribe"):
    """Subscribe to channels."""

    subscriptions: Annotated[list[Subscription], Many]


class Unsubscribe(Struct, frozen=True, tag_field="op", tag="unsubscribe"):
    """End subscriptions."""

    subscriptionIds: Annotated[list[Id], Many]


class ClientChannel(Struct, frozen=True):
    """Channel on which a client publishes."""

    id: Id
    topic: str
    encoding: str
    schemaName: str


class Advertise(Struct, frozen=True, tag_field="op", tag="advertise"):
    """Begin to publish."""

    channels: Annotated[list[ClientChannel], Many]


class Unadvertise(Struct, frozen=True, tag_field="op", tag="unadvertise"):
    """Publish no more."""

    channelIds: Annotated[list[Id], Many]


class GetParameters(Struct, frozen=True, tag_field="op", tag="getParameters"):
    """Read parameters; with no names all of them."""

    parameterNames: Annotated[list[str], Many]
    id: str | None = None


class Parameter(Struct, frozen=True):
    """Parameter, without a value if it is to be deleted."""

    name: str
    value: Any = None
    type: str | None = None


class SetParameters(Struct, frozen=True, tag_field="op", tag="setParameters"):
    """Set parameters; with an id their values are sent back."""

    parameters: Annotated[list[Parameter], Many]
    id: str | None = None


class SubscribeParameters(Struct, frozen=True, tag_field="op", tag="subscribeParameterUpdates"):
    """Ask for the changes of parameters."""

    parameterNames: Annotated[list[str], Many]


class UnsubscribeParameters(Struct, frozen=True, tag_field="op", tag="unsubscribeParameterUpdates"):
    """Ask for the changes of parameters no more."""

    parameterNames: Annotated[list[str], Many]


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


class PlaybackCommand(NamedTuple):
    """Command to play or pause, at a speed, and from a time (ns since 1970) on if it is given."""

    play: bool
    speed: float
    seek: int | None
    request: str


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
    """Decode a text message.

    Raises:
        InvalidRequest: It is none of the protocol.
        LimitExceeded: It has too many values.
    """
    check_value_count(payload, "the message")
    try:
        return _decoder.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InvalidRequest(f"the message is not one of the Foxglove protocol: {str(error)[:300]}") from None


def decode_binary(payload: bytes) -> ClientMessage | ServiceRequest | PlaybackCommand:
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
        if view[0] == PLAYBACK:
            command, speed, seeks, time_, length = _COMMAND.unpack_from(view, 1)
            end = 1 + _COMMAND.size + length
            if command > 1 or not 0 < speed < math.inf or end > len(view):
                raise InvalidRequest(
                    "the command is to play (0) or to pause (1), at a speed above 0, with a request id"
                )
            return PlaybackCommand(not command, speed, time_ if seeks else None, str(view[end - length : end], "utf-8"))
    except (struct.error, IndexError, UnicodeDecodeError):
        raise InvalidRequest(f"the binary message of {len(view)} bytes is cut off or malformed") from None
    raise InvalidRequest(f"a binary message with opcode {view[0]} is not understood: it must be 1, 2 or 3")


def message_data(subscription: int, payload: Buffer) -> BinaryFrame:
    """Return the frame of a message, with the present time as its log time."""
    return BinaryFrame(_DATA.pack(MESSAGE_DATA, subscription, time_ns()), memoryview(payload))


def service_response(request: ServiceRequest, payload: Buffer) -> BinaryFrame:
    """Return the frame of a response."""
    encoding = request.encoding.encode()
    head = bytes([SERVICE_RESPONSE]) + _CALL.pack(request.service, request.call, len(encoding)) + encoding
    return BinaryFrame(head, memoryview(payload))


def time(nanoseconds: int) -> BinaryFrame:
    """Return the frame of a time in ns since 1970."""
    return BinaryFrame(struct.pack("<BQ", TIME, max(0, nanoseconds)), memoryview(b""))


def playback_state(state: PlaybackState) -> BinaryFrame:
    """Return the frame of a playback's state."""
    request = state.request.encode()
    fields = (STATUSES[state.status], state.time, state.speed, state.seeked, len(request))
    return BinaryFrame(_STATE.pack(PLAYBACK_STATE, *fields), memoryview(request))


def asset(request: int, data: bytes) -> BinaryFrame:
    """Return the frame of an asset."""
    return BinaryFrame(struct.pack("<BIBI", ASSET, request, 0, 0), memoryview(data))


def asset_error(request: int, error: str) -> BinaryFrame:
    """Return the frame of an asset that cannot be had."""
    text = error.encode()
    return BinaryFrame(struct.pack("<BIBI", ASSET, request, 1, len(text)), memoryview(text))


def text(**fields: object) -> bytes:
    """Return a message as JSON."""
    return msgspec.json.encode(fields)
