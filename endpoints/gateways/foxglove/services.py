"""Calls of services by a client, in CDR or JSON."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from msgspec import Raw

from endpoints.gateways.foxglove import messages
from endpoints.gateways.foxglove.messages import ServiceRequest
from endpoints.gateways.foxglove.offers import Offer
from endpoints.gateways.guest import Guest
from endpoints.gateways.uses import CALL, Arrived, Frame, Use
from endpoints.robot.services import MAX_PENDING
from rce.errors import InvalidRequest, LimitExceeded, NotFound, RceError


@dataclass(eq=False)
class _Call:
    request: ServiceRequest
    use: Use | None = None


class Calls:
    """Calls of one client. The use of a service is kept for further calls."""

    def __init__(self, guest: Guest) -> None:
        self._guest = guest
        self._numbers = itertools.count(1)
        self._uses: dict[tuple[str, str, str], Use] = {}  # by service, type and encoding
        self._calls: dict[str, _Call] = {}

    def call(self, request: ServiceRequest, offer: Offer | None) -> None:
        """Call a service; its response or failure is sent when it comes."""
        number = str(next(self._numbers))
        self._calls[number] = _Call(request._replace(payload=memoryview(b"")))  # the payload may be large
        if offer is None:
            self._fail(number, NotFound(f"service {request.service} is not offered"))
        elif request.encoding not in ("cdr", "json"):
            self._fail(number, InvalidRequest(f"encoding {request.encoding[:40]!r} is not supported: use cdr or json"))
        elif len(self._calls) > MAX_PENDING:
            self._fail(number, LimitExceeded(f"{MAX_PENDING} calls are unanswered: wait for their answers"))
        else:
            try:
                self._guest.run(self._call(number, request, offer), len(request.payload))
            except LimitExceeded as error:
                self._fail(number, error)

    async def _call(self, number: str, request: ServiceRequest, offer: Offer) -> None:
        try:
            use = self._calls[number].use = self._use_of(offer, request.encoding)
            await asyncio.shield(use.ready)
        except RceError as error:
            self._fail(number, error)
            return
        value = Raw(request.payload) if request.encoding == "json" else request.payload
        self._guest.data(use, number, value, lambda error: self._fail(number, error))

    def _use_of(self, offer: Offer, encoding: str) -> Use:
        key = offer.name, offer.type, encoding
        if key in self._uses:
            return self._uses[key]
        is_json = encoding == "json"
        use = self._uses[key] = self._guest.use(
            CALL,
            offer.name,
            offer.type,
            self._answered,
            self._fail,
            form="Converter" if is_json else "Forwarder",
            format="rosbridge" if is_json else "cdr",
        )
        use.on_end(lambda error: self._ended(key, use, error))
        return use

    def _ended(self, key: tuple[str, str, str], use: Use, error: RceError) -> None:
        if self._uses.get(key) is use:
            del self._uses[key]
        for number in [number for number, call in self._calls.items() if call.use is use]:
            self._fail(number, error)

    def _answered(self, arrived: Arrived) -> Sequence[Frame]:
        call = self._calls.pop(arrived.message.msgID, None)
        if call is None:
            return ()
        return (messages.service_response(call.request, arrived.value[:-1] if arrived.blob is None else arrived.blob),)

    def _fail(self, number: str, error: RceError) -> None:
        call = self._calls.pop(number, None)
        if call is not None:
            fields = {"serviceId": call.request.service, "callId": call.request.call}
            self._guest.send(messages.text(op="serviceCallFailure", **fields, message=str(error)))
