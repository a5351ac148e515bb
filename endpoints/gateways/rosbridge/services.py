"""Services that a client calls and serves."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
from msgspec import UNSET, Raw, UnsetType

from endpoints.gateways.guest import Guest
from endpoints.gateways.rosbridge import encoding
from endpoints.gateways.rosbridge.encoding import Form
from endpoints.gateways.rosbridge.operations import (
    AdvertiseService,
    CallService,
    Id,
    ServiceResponse,
    UnadvertiseService,
)
from endpoints.gateways.rosbridge.peer import Peer
from endpoints.gateways.uses import CALL, SERVE, Arrived, Frame, Use
from endpoints.robot.services import MAX_PENDING
from rce.errors import InvalidRequest, LimitExceeded, NotConnected, NotFound, RceError, TimedOut
from rce.protocol.names import parse_type

MAX_SERVICES = 200  # services of one client that are kept for further calls
MAX_TIMEOUT = 86_400.0  # seconds
TIMED_OUT = "Timeout exceeded while waiting for service response"  # as rosbridge says it, by which clients know it


@dataclass(eq=False)
class _Call:
    service: str
    id: Id
    form: Form
    use: Use | None = None
    timer: asyncio.TimerHandle | None = None


class ServiceCalls:
    """Calls of a client. The use of a service is kept for further calls."""

    def __init__(self, guest: Guest, peer: Peer) -> None:
        self._guest = guest
        self._peer = peer
        self._numbers = itertools.count(1)
        self._uses: dict[tuple[str, str], Use] = {}
        self._calls: dict[str, _Call] = {}

    def call(self, op: CallService) -> None:
        """Call a service; its answer or error is sent when it comes."""
        number = str(next(self._numbers))
        form = Form(op.compression or "none", op.fragment_size or 0)
        call = _Call(op.service, op.id, form)
        if len(self._calls) >= MAX_PENDING:
            self._answer_error(call, LimitExceeded(f"{MAX_PENDING} calls are unanswered: wait for their answers"))
            return
        self._calls[number] = call
        if op.timeout:
            error = TimedOut(TIMED_OUT)
            delay = min(op.timeout, MAX_TIMEOUT)
            call.timer = asyncio.get_running_loop().call_later(delay, self.fail, number, error)
        try:
            self._guest.run(self._call(number, op), len(memoryview(op.args)))
        except LimitExceeded as error:
            self.fail(number, error)

    def close(self) -> None:
        """Forget all calls: the client has left."""
        for number in list(self._calls):
            self._pop(number)

    async def _call(self, number: str, op: CallService) -> None:
        try:
            await self._guest.changes.settle()
            type = op.type or await find_service_type(self._guest, op.service)
            use = self._use_of(op.service, type, "cbor" if op.compression in ("cbor", "cbor-raw") else "rosbridge")
            await asyncio.shield(use.ready)
            args = Raw(await self._arguments(op, type))
        except RceError as error:
            self.fail(number, error)
            return
        if (call := self._calls.get(number)) is not None:
            call.use = use
            self._guest.data(use, number, args, lambda error: self.fail(number, error))

    async def _arguments(self, op: CallService, type: str) -> bytes:
        """Return the arguments as an object; a list has them in the order of the fields."""
        text = bytes(op.args).strip()
        if not text.startswith(b"["):
            return text if text not in (b"", b"null") else b"{}"
        name = parse_type(type)
        request = (await self._guest.view.definitions(str(name), "srv"))[f"{name.srv}_Request"]
        return encoding.object_of(text, [field.name for field in request])

    def _use_of(self, service: str, type: str, format: str) -> Use:
        key = service, format
        present = self._uses.get(key)
        if present is not None and parse_type(present.type) == parse_type(type):
            return present
        use = self._guest.use(CALL, service, type, self._answered, self.fail, format=format)
        if present is not None or len(self._uses) >= MAX_SERVICES:
            self._drop(self._uses.pop(key if present is not None else next(iter(self._uses))))
        self._uses[key] = use
        use.on_end(lambda error: self._ended(key, use, error))
        return use

    def _drop(self, use: Use) -> None:
        self._guest.drop(use)
        error = NotConnected(f"service {use.address} is called with another type now, or too many others are called")
        self._fail_calls(use, error)

    def _ended(self, key: tuple[str, str], use: Use, error: RceError) -> None:
        if self._uses.get(key) is use:
            del self._uses[key]
        self._fail_calls(use, error)

    def _fail_calls(self, use: Use, error: RceError) -> None:
        for number in [number for number, call in self._calls.items() if call.use is use]:
            self.fail(number, error)

    def _answered(self, arrived: Arrived) -> Sequence[Frame]:
        call = self._pop(arrived.message.msgID)
        if call is None:
            return ()
        fields = _response(call, True)
        if arrived.blob is not None:
            if not isinstance(call.id, UnsetType):
                fields["id"] = msgspec.json.decode(call.id)
            return encoding.cbor("values", arrived.blob, **fields)
        return encoding.with_value("values", arrived.value, call.form, **fields)

    def fail(self, number: str, error: RceError) -> None:
        """Answer a call with an error."""
        call = self._pop(number)
        if call is not None:
            self._answer_error(call, error)

    def _answer_error(self, call: _Call, error: RceError) -> None:
        form = Form("none", call.form.fragment_size)
        self._guest.send(*encoding.encoded(encoding.text(**_response(call, False), values=str(error)), form))

    def _pop(self, number: str) -> _Call | None:
        call = self._calls.pop(number, None)
        if call is not None and call.timer is not None:
            call.timer.cancel()
        return call


def _response(call: _Call, result: bool) -> dict[str, object]:
    fields: dict[str, object] = {"op": "service_response", "service": call.service, "result": result}
    return fields if call.id is UNSET else fields | {"id": call.id}


class ServedServices:
    """Services that a client serves."""

    def __init__(self, guest: Guest, peer: Peer) -> None:
        self._guest = guest
        self._peer = peer
        self._uses: dict[str, Use] = {}
        self._unanswered: dict[str, tuple[str, str]] = {}  # service and msgID by the id that the client was given
        self._numbers = itertools.count(1)

    def advertise(self, op: AdvertiseService) -> None:
        """Begin to serve a service, in place of an earlier one of this name; raises InvalidRequest or LimitExceeded."""
        parse_type(op.type)
        self._guest.check_room()  # before the earlier one is dropped
        self._drop(op.service)

        def receive(arrived: Arrived) -> Sequence[Frame]:
            id = f"service_request:{op.service}:{next(self._numbers)}"
            self._unanswered[id] = op.service, arrived.message.msgID
            while len(self._unanswered) > 2 * MAX_PENDING:  # they have timed out
                del self._unanswered[next(iter(self._unanswered))]
            return encoding.with_value("args", arrived.value, op="call_service", service=op.service, id=id)

        use = self._guest.use(SERVE, op.service, op.type, receive, lambda _, error: self._peer.report(error))
        self._uses[op.service] = use
        use.on_end(lambda error: self._ended(op, use, error))

    def _ended(self, op: AdvertiseService, use: Use, error: RceError) -> None:
        if self._uses.get(op.service) is use:
            del self._uses[op.service]
        self._peer.report(error, op.id)

    def unadvertise(self, op: UnadvertiseService) -> None:
        """Serve a service no more."""
        self._drop(op.service)

    def _drop(self, service: str) -> None:
        use = self._uses.pop(service, None)
        if use is not None:
            self._guest.drop(use)

    def respond(self, op: ServiceResponse) -> None:
        """Answer a call of the environment.

        Raises:
            InvalidRequest: There is no such call.
        """
        service, msg_id = self._unanswered.pop(encoding.as_text(op.id), ("", ""))
        use = self._uses.get(service)
        if use is None:
            raise InvalidRequest(f"there is no unanswered call with this id of service {op.service[:200]}")
        if op.result:
            self._guest.data(use, msg_id, op.values, self._peer.report)
        else:
            self._guest.data(use, msg_id, Raw(b"{}"), self._peer.report, error=encoding.as_text(op.values))


async def find_service_type(guest: Guest, service: str) -> str:
    """Return the type of a service of the environment; raise NotFound if there is none."""
    for age in (1.0, 0.0):
        for each in (await guest.view.graph(age)).services:
            if each.name == service:
                return each.types[0]
    raise NotFound(f"service {service[:200]} does not exist")
