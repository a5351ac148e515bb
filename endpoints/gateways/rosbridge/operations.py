"""Operations of clients: the JSON objects of rosbridge by their `op`."""

from __future__ import annotations

import re
from typing import Any, Literal

import msgspec
from msgspec import UNSET, Raw, Struct, UnsetType

from rce.errors import InvalidRequest
from rce.protocol.messages import Decimation
from rce.protocol.messages.commands import FieldPath
from rce.protocol.messages.large import find_content

MAX_ID = 1000  # bytes
# Bytes of an operation above which the event loop does not search its content for errors, which takes milliseconds.
LARGE = 1024 * 1024
_content = re.compile(rb'"(msg|args|values)"[ \t\n\r]*:[ \t\n\r]*(?=\{)')
Id = Raw | UnsetType
"""Any JSON value of at most MAX_ID bytes; it is returned as it came."""
Compression = Literal["none", "png", "cbor", "cbor-raw"]


class Operation(Struct, frozen=True, kw_only=True, tag_field="op"):
    """Base of all operations."""

    id: Id = UNSET


class Advertise(Operation, frozen=True, kw_only=True, tag="advertise"):
    """Begin to publish."""

    topic: str
    type: str = ""
    latch: bool = False
    queue_size: int | None = None


class Unadvertise(Operation, frozen=True, kw_only=True, tag="unadvertise"):
    """Publish no more."""

    topic: str


class Publish(Operation, frozen=True, kw_only=True, tag="publish"):
    """Publish a message; on a topic that is not advertised, `type` and `id` are those of an advertisement."""

    topic: str
    msg: Raw = Raw(b"{}")
    type: str = ""


class Subscribe(Operation, frozen=True, kw_only=True, tag="subscribe"):
    """Subscribe to a topic; times in milliseconds, sizes in bytes.

    `fields`, `decimate` and `codec` are additions of RCE.
    """

    topic: str
    type: str | None = None
    throttle_rate: float | None = 0
    queue_length: int | None = 0
    fragment_size: int | None = None
    compression: Compression | None = "none"
    fields: tuple[FieldPath, ...] | None = None
    decimate: Decimation | None = None
    codec: str | None = None


class Unsubscribe(Operation, frozen=True, kw_only=True, tag="unsubscribe"):
    """End one subscription of a topic, or without `id` all of them."""

    topic: str


class CallService(Operation, frozen=True, kw_only=True, tag="call_service"):
    """Call a service; `timeout` is in seconds."""

    service: str
    args: Raw = Raw(b"{}")
    type: str | None = None
    timeout: float | None = None
    fragment_size: int | None = None
    compression: Compression | None = "none"


class AdvertiseService(Operation, frozen=True, kw_only=True, tag="advertise_service"):
    """Begin to serve a service."""

    service: str
    type: str


class UnadvertiseService(Operation, frozen=True, kw_only=True, tag="unadvertise_service"):
    """Serve a service no more."""

    service: str


class ServiceResponse(Operation, frozen=True, kw_only=True, tag="service_response"):
    """Answer a call; with a `result` of false, `values` say why it failed."""

    service: str
    values: Raw = Raw(b"{}")
    result: bool = True


class AdvertiseAction(Operation, frozen=True, kw_only=True, tag="advertise_action"):
    """Begin to carry out goals."""

    action: str
    type: str


class UnadvertiseAction(Operation, frozen=True, kw_only=True, tag="unadvertise_action"):
    """Carry out goals no more."""

    action: str


class SendActionGoal(Operation, frozen=True, kw_only=True, tag="send_action_goal"):
    """Send a goal."""

    action: str
    action_type: str = ""
    args: Raw = Raw(b"{}")
    feedback: bool = False
    fragment_size: int | None = None
    compression: Compression | None = "none"


class CancelActionGoal(Operation, frozen=True, kw_only=True, tag="cancel_action_goal"):
    """Cancel the goal that was sent with this id."""

    action: str


class ActionFeedback(Operation, frozen=True, kw_only=True, tag="action_feedback"):
    """Send feedback about a goal that the client carries out."""

    action: str
    values: Raw = Raw(b"{}")


class ActionResult(Operation, frozen=True, kw_only=True, tag="action_result"):
    """Send the result of a goal that the client carries out, with a status of `action_msgs/GoalStatus`."""

    action: str
    values: Raw = Raw(b"{}")
    status: int = 4
    result: bool = True


class Fragment(Struct, frozen=True, tag_field="op", tag="fragment"):
    """One of `total` pieces of the JSON text of another operation."""

    id: Raw
    data: str
    num: int
    total: int


class SetLevel(Operation, frozen=True, kw_only=True, tag="set_level"):
    """Ask for statuses of this level and above."""

    level: Literal["none", "error", "warning", "info"] = "error"


class Auth(Operation, frozen=True, kw_only=True, tag="auth"):
    """Credentials of ROS 1, which are ignored: the client is logged in already."""


class Status(Operation, frozen=True, kw_only=True, tag="status"):
    """A status of the client, which is ignored."""

    level: Any = ""


AnyOperation = (
    Advertise
    | Unadvertise
    | Publish
    | Subscribe
    | Unsubscribe
    | CallService
    | AdvertiseService
    | UnadvertiseService
    | ServiceResponse
    | AdvertiseAction
    | UnadvertiseAction
    | SendActionGoal
    | CancelActionGoal
    | ActionFeedback
    | ActionResult
    | Fragment
    | SetLevel
    | Auth
    | Status
)

_decoder: msgspec.json.Decoder[AnyOperation] = msgspec.json.Decoder(AnyOperation)


def decode(payload: bytes | bytearray | memoryview) -> AnyOperation:
    """Decode an operation.

    Raises:
        InvalidRequest: It is no operation of rosbridge, lacks a field, or has too long an id.
    """
    try:
        operation = (_decode_large(payload) if len(payload) > LARGE else None) or _decoder.decode(payload)
        return operation if isinstance(operation.id, UnsetType) else _with_own_id(operation, operation.id)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InvalidRequest(f"the message is not an operation of rosbridge: {str(error)[:300]}") from None


def _decode_large(payload: bytes | bytearray | memoryview) -> AnyOperation | None:
    """Decode an operation without its content, which is checked when it is converted; None for an unusual one."""
    text = bytes(payload)
    found = find_content(text, _content, 1)
    if found is None:
        return None
    name = found.key[1].decode()
    try:
        operation = _decoder.decode(text[: found.start] + b"null" + text[found.end :])
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None
    if bytes(getattr(operation, name, b"")) != b"null":
        return None
    content: dict[str, Any] = {name: Raw(memoryview(text)[found.start : found.end])}
    return msgspec.structs.replace(operation, **content)


def _with_own_id(operation: AnyOperation, id: Raw) -> AnyOperation:
    """Return an operation with a copy of its id: the id as it came would keep the whole message in memory."""
    text = bytes(id)
    if len(text) > MAX_ID:
        raise InvalidRequest(f"an id may have {MAX_ID} bytes, not {len(text)}", field="id")
    msgspec.json.decode(text)  # which is not done when the operation is decoded
    return msgspec.structs.replace(operation, id=Raw(text))


def key(id: Id) -> bytes:
    """Return the text of an id; empty for none."""
    return b"" if isinstance(id, UnsetType) else bytes(id)
