"""A client of rosbridge: its WebSocket messages are operations."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

import msgspec
from msgspec import UNSET
from twisted.logger import Logger

from endpoints.gateways.graphs import Graphs
from endpoints.gateways.guest import FEATURES, Guest
from endpoints.gateways.rosbridge import encoding
from endpoints.gateways.rosbridge import operations as ops
from endpoints.gateways.rosbridge.actions import SentGoals, ServedActions
from endpoints.gateways.rosbridge.fragments import Fragments
from endpoints.gateways.rosbridge.rosapi import Rosapi
from endpoints.gateways.rosbridge.services import ServedServices, ServiceCalls
from endpoints.gateways.rosbridge.topics import Publications, Subscriptions, find_topic_type
from endpoints.robot.client import Accepted
from endpoints.robot.endpoint import RobotEndpoint
from endpoints.robot.handshake import Request
from endpoints.robot.intake import BadMessages
from endpoints.robot.session import Socket
from rce.errors import InvalidRequest, RceError
from rce.process.metrics import errors

MAX_ANSWERS = 8  # of rosapi that one client is given at once
LEVELS = {"none": 0, "error": 1, "warning": 2, "info": 3}

log = Logger()


class RosbridgeClient:
    """A client of rosbridge in one environment.

    Statuses are sent only once the client has asked for them by `set_level`: roslibpy ends with an error otherwise.

    Args:
        endpoint: The Robot endpoint.
        graphs: Graphs of environments.
        place: The environment as `TAG` or `OWNER/TAG`.
    """

    features = FEATURES

    def __init__(self, endpoint: RobotEndpoint, graphs: Graphs, place: str) -> None:
        self._guest = guest = Guest(endpoint, graphs, "rosbridge", place)
        self._limits = endpoint.limits
        self._level = "none"
        self._fragments = Fragments(self._limits.message)
        self._publications = Publications(guest, self)
        self._subscriptions = Subscriptions(guest, self)
        self._calls = ServiceCalls(guest, self)
        self._served = ServedServices(guest, self)
        self._goals = SentGoals(guest, self)
        self._actions = ServedActions(guest, self)
        self._rosapi = Rosapi(guest)
        self._answering = asyncio.Semaphore(MAX_ANSWERS)
        self._handlers: dict[type[Any], Callable[[Any], None]] = {
            ops.Publish: self._publications.publish,
            ops.Advertise: self._publications.advertise,
            ops.Unadvertise: self._publications.unadvertise,
            ops.Subscribe: self._subscriptions.subscribe,
            ops.Unsubscribe: self._subscriptions.unsubscribe,
            ops.CallService: self._call_service,
            ops.AdvertiseService: self._served.advertise,
            ops.UnadvertiseService: self._served.unadvertise,
            ops.ServiceResponse: self._served.respond,
            ops.AdvertiseAction: self._actions.advertise,
            ops.UnadvertiseAction: self._actions.unadvertise,
            ops.SendActionGoal: self._goals.send,
            ops.CancelActionGoal: self._goals.cancel,
            ops.ActionFeedback: self._actions.feedback,
            ops.ActionResult: self._actions.result,
            ops.Fragment: self._fragment,
            ops.SetLevel: self._set_level,
            ops.Auth: _ignore,
            ops.Status: _ignore,
        }

    # --- client of a WebSocket ----------------------------------------------------------------------------------------

    @property
    def user(self) -> str:
        """The user whose turns it takes."""
        return self._guest.user

    async def login(self, request: Request) -> Accepted:
        """Log in as a guest; raises RceError."""
        return await self._guest.login(request)

    def abandoned(self) -> None:
        """End the session, whose socket was never opened."""
        self._guest.abandoned()

    def opened(self, socket: Socket) -> None:
        """Begin to exchange messages."""
        self._bad = BadMessages(self._limits.bad_messages, socket.end)
        self._guest.opened(socket)

    def closed(self, normal: bool, reason: str) -> None:
        """End the session."""
        self._calls.close()
        self._guest.closed(normal, reason)

    def text(self, payload: bytes) -> None:
        """Handle an operation."""
        try:
            operation = ops.decode(payload)
        except RceError as error:
            self.report(error)
            return
        self._handle(operation)

    def binary(self, *fragments: bytes) -> None:
        """Refuse a binary message: rosbridge sends binary data to clients only."""
        self.report(InvalidRequest("binary messages are not understood: send operations as JSON text"))

    def sweep(self) -> None:
        """Forget fragments whose others did not come."""
        self._fragments.sweep(time.monotonic())

    def hold(self) -> None:
        """Keep messages to the client."""
        self._guest.hold()

    def proceed(self) -> None:
        """Send messages again."""
        self._guest.proceed()

    # --- operations ---------------------------------------------------------------------------------------------------

    def _handle(self, operation: ops.AnyOperation) -> None:
        try:
            self._handlers[type(operation)](_resolved(operation))
        except RceError as error:
            self.report(error, operation.id)

    def _fragment(self, operation: ops.Fragment) -> None:
        whole = self._fragments.add(operation, time.monotonic())
        if whole is None:
            return
        inner = ops.decode(whole)
        if isinstance(inner, ops.Fragment):
            raise InvalidRequest("a fragment of fragments is not accepted")
        self._handle(inner)

    def _call_service(self, operation: ops.CallService) -> None:
        if not self._rosapi.has(operation.service):
            self._calls.call(operation)
            return
        form = encoding.Form("none", operation.fragment_size or 0)
        fields: dict[str, object] = {"op": "service_response", "service": operation.service}
        if operation.id is not UNSET:
            fields["id"] = operation.id
        self._guest.run(self._answer(operation, fields, form))

    async def _answer(self, operation: ops.CallService, fields: dict[str, object], form: encoding.Form) -> None:
        async with self._answering:
            try:
                values: object = await self._rosapi.call(operation.service, bytes(operation.args))
                result = True
            except RceError as error:
                values, result = str(error), False
            self._guest.send(*encoding.encoded(encoding.text(**fields, result=result, values=values), form))
            await self._guest.wait_for_room()

    def _set_level(self, operation: ops.SetLevel) -> None:
        self._level = operation.level

    # --- peer of its topics, services and actions ---------------------------------------------------------------------

    def report(self, error: RceError, id: ops.Id = UNSET) -> None:
        """Count an error of the client and, if it asked for statuses, send it."""
        errors.add("rosbridge", error.info.code)
        if LEVELS[self._level] >= LEVELS["error"]:
            fields: dict[str, object] = {"op": "status", "level": "error", "msg": str(error)}
            self._guest.send(encoding.text(**fields if id is UNSET else fields | {"id": id}))
        else:
            log.info("client {client}: {error}", client=self._guest.name, error=str(error))
        self._bad.count(error)

    def pause_until(self, ready: asyncio.Future[None]) -> None:
        """Read nothing more from the client until a future is done."""
        self._guest.pause_reading(ready)

    async def type_of_topic(self, topic: str) -> str:
        """Return the type of a topic of the environment; raise NotFound if it has none."""
        return await find_topic_type(self._guest, topic)


def _resolved(operation: Any) -> Any:
    """Return an operation whose name of a topic, service or action begins with a slash."""
    for field in ("topic", "service", "action"):
        name = getattr(operation, field, None)
        if name is not None and not name.startswith("/"):
            return msgspec.structs.replace(operation, **{field: f"/{name}"})
    return operation


def _ignore(_: ops.AnyOperation) -> None:
    """Do nothing."""
