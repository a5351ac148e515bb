"""Calls of services by a client, in CDR or JSON."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Sequence

from msgspec import Raw

from endpoints.gateways.foxglove import messages
from endpoints.gateways.foxglove.messages import ServiceRequest
from endpoints.gateways.foxglove.offers import Offer
from endpoints.gateways.guest import Guest
from endpoints.gateways.uses import CALL, Arrived, Frame, Use
from endpoints.robot.services import MAX_PENDING
from rce.errors import InvalidRequest, LimitExceeded, NotFound, RceError


class Calls:
    """Calls of one client. The use of a service is kept for further calls."""

    def __init__(self, guest: Guest) -> None:
        self._guest = guest
        self._numbers = itertools.count(1)
        self._uses: dict[tuple[str, str], Use] = {}
        self._calls: dict[str, ServiceRequest] = {}

    def call(self, request: ServiceRequest, offer: Offer | None) -> None:
        """Call a service; its response or failure is sent when it comes."""
        number = str(next(self._numbers))
        self._calls[number] = request._replace(payload=memoryview(b""))  # the payload may be large
        if offer is None:
            self._fail(number, NotFound(f"service {request.service} is not offered"))
        elif request.encoding not in ("cdr", "json"):
            self._fail(number, InvalidRequest(f"encoding {request.encoding[:40]!r} is not supported: use cdr or json"))
        elif len(self._calls) > MAX_PENDING:
            self._fail(number, LimitExceeded(f"{MAX_PENDING} calls are unanswered: wait for their answers"))
        else:
            self._guest.run(self._call(number, request, offer), len(request.payload))

    async def _call(self, number: str, request: ServiceRequest, offer: Offer) -> None:
        try:
            use = self._use_of(offer, request.encoding)
            await asyncio.shield(use.ready)
        except RceError as error:
            self._uses.pop((offer.name, request.encoding), None)
            self._fail(number, error)
            return
        value = Raw(request.payload) if request.encoding == "json" else request.payload
        self._guest.data(use, number, value, lambda error: self._fail(number, error))

    def _use_of(self, offer: Offer, encoding: str) -> Use:
        key = offer.name, encoding
        if key not in self._uses:
            is_json = encoding == "json"
            self._uses[key] = self._guest.use(
                CALL,
                offer.name,
                offer.type,
                self._answered,
                self._fail,
                form="Converter" if is_json else "Forwarder",
                format="rosbridge" if is_json else "cdr",
            )
        return self._uses[key]

    def _answered(self, arrived: Arrived) -> Sequence[Frame]:
        request = self._calls.pop(arrived.message.msgID, None)
        if request is None:
            return ()
        return (messages.service_response(request, arrived.value[:-1] if arrived.blob is None else arrived.blob),)

    def _fail(self, number: str, error: RceError) -> None:
        request = self._calls.pop(number, None)
        if request is not None:
            fields = {"serviceId": request.service, "callId": request.call}
            self._guest.send(messages.text(op="serviceCallFailure", **fields, message=str(error)))
