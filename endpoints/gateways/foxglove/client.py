"""A client of the Foxglove protocol."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from functools import partial
from typing import TypeVar

from twisted.logger import Logger

from endpoints.gateways.foxglove import messages, offers, options
from endpoints.gateways.foxglove.channels import Publications, Subscriptions
from endpoints.gateways.foxglove.messages import ClientMessage, PlaybackCommand
from endpoints.gateways.foxglove.offers import Connections, Offers
from endpoints.gateways.foxglove.parameters import ClientParameters
from endpoints.gateways.foxglove.playback import Playback
from endpoints.gateways.foxglove.services import Calls
from endpoints.gateways.graphs import Graphs
from endpoints.gateways.guest import FEATURES, Guest
from endpoints.robot.client import Accepted
from endpoints.robot.endpoint import RobotEndpoint
from endpoints.robot.handshake import Request
from endpoints.robot.intake import BadMessages
from endpoints.robot.session import Socket
from rce.bag.playback import PlaybackState
from rce.control.calls.watching import RosGraph
from rce.errors import InvalidRequest, RceError
from rce.process.metrics import errors

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
CAPABILITIES = ["clientPublish", "parameters", "parametersSubscribe", "services", "connectionGraph", "assets", "time"]
INTERVAL = 1.0  # seconds between two looks at the graph
MAX_ANSWERS = 8  # about parameters that one client is given at once
MAX_ASSETS = 2  # that one client is given at once
MAX_REPORTED = 20  # errors about items of one message that are told one by one
ERROR = 2  # level of a status
T = TypeVar("T")

log = Logger()


class FoxgloveClient:
    """A client of the Foxglove protocol in one environment.

    Args:
        endpoint: The Robot endpoint.
        graphs: Graphs of environments.
        place: The environment as `TAG` or `OWNER/TAG`.
    """

    features = FEATURES

    def __init__(self, endpoint: RobotEndpoint, graphs: Graphs, place: str) -> None:
        self._guest = guest = Guest(endpoint, graphs, "foxglove", place)
        self._limits = endpoint.limits
        self._topics: Offers  # from the login on, which has the options
        self._subscriptions: Subscriptions
        self._services = Offers(guest, "srv")
        self._publications = Publications(guest, self.report)
        self._calls = Calls(guest)
        self._parameters = ClientParameters(guest, self.report)
        self._playback = Playback(guest, self._greeting, self.report)
        self._answering = asyncio.Semaphore(MAX_ANSWERS)
        self._fetching = asyncio.Semaphore(MAX_ASSETS)
        self._looking = asyncio.Lock()
        self._connections: Connections | None = None  # as the client knows them, if it asked

    # --- client of a WebSocket ----------------------------------------------------------------------------------------

    @property
    def user(self) -> str:
        """The user whose turns it takes."""
        return self._guest.user

    async def login(self, request: Request) -> Accepted:
        """Log in as a guest.

        Raises:
            InvalidRequest: The client offers no subprotocol of Foxglove, or an option of its URL is wrong.
            RceError: The login is refused.
        """
        offered = str(request.headers.get("sec-websocket-protocol", "")).replace(" ", "").split(",")
        chosen = next((each for each in offered if each in SUBPROTOCOLS), None)
        if chosen is None:
            raise InvalidRequest(f"offer a subprotocol of Foxglove: {' or '.join(SUBPROTOCOLS)}")
        chosen_options = options.parse(request)
        self._topics = Offers(self._guest, "msg", chosen_options.codecs)
        self._subscriptions = Subscriptions(self._guest, chosen_options, self.report)
        await self._guest.login(request)
        return Accepted(subprotocol=chosen)

    def abandoned(self) -> None:
        """End the session, whose socket was never opened."""
        self._guest.abandoned()

    def opened(self, socket: Socket) -> None:
        """Greet the client, and begin to tell it of what there is."""
        self._bad = BadMessages(self._limits.bad_messages, socket.end)
        self._guest.opened(socket)
        self._guest.send(self._greeting(None))
        self._guest.run(self._watch())

    def _greeting(self, playback: PlaybackState | None) -> bytes:
        """Return the message that says what the client can do, again when a playback comes or goes."""
        greeting: dict[str, object] = {"name": self._guest.environment, "capabilities": CAPABILITIES}
        if playback is not None:
            greeting["capabilities"] = [*CAPABILITIES, "playbackControl"]
            greeting |= {"dataStartTime": playback.start, "dataEndTime": playback.end}
        encodings, metadata = ["cdr", "json"], {"ROS_DISTRO": "kilted"}
        greeting |= {"sessionId": self._guest.name, "supportedEncodings": encodings, "metadata": metadata}
        return messages.text(op="serverInfo", **greeting)

    def closed(self, normal: bool, reason: str) -> None:
        """End the session."""
        self._guest.closed(normal, reason)

    def text(self, payload: bytes) -> None:
        """Handle a JSON message."""
        try:
            self._handle(messages.decode(payload), len(payload))
        except RceError as error:
            self.report(error)

    def binary(self, *fragments: bytes) -> None:
        """Handle a message on a channel, or a call."""
        try:
            message = messages.decode_binary(b"".join(fragments))
            if isinstance(message, ClientMessage):
                self._publications.publish(message)
            elif isinstance(message, PlaybackCommand):
                self._playback.control(message)
            else:
                self._calls.call(message, self._services.by_number.get(message.service))
        except RceError as error:
            self.report(error)

    def sweep(self) -> None:
        """Do nothing: messages come whole."""

    def hold(self) -> None:
        """Keep messages to the client."""
        self._guest.hold()

    def proceed(self) -> None:
        """Send messages again."""
        self._guest.proceed()

    # --- messages -----------------------------------------------------------------------------------------------------

    def _handle(self, message: messages.AnyMessage, size: int) -> None:
        match message:
            case messages.Subscribe(subscriptions):
                self._each(subscriptions, self._subscribe)
            case messages.Unsubscribe(ids):
                for id in ids:
                    self._subscriptions.remove(id)
            case messages.Advertise(channels):
                self._each(channels, self._publications.add)
            case messages.Unadvertise(numbers):
                for number in numbers:
                    self._publications.remove(number)
            case messages.GetParameters(names, id):
                self._guest.run(self._answer(self._answering, partial(self._parameters.get, names, id)), size)
            case messages.SetParameters(parameters, id):
                self._guest.run(self._answer(self._answering, partial(self._parameters.set, parameters, id)), size)
            case messages.SubscribeParameters(names):
                self._parameters.subscribe(names)
            case messages.UnsubscribeParameters(names):
                self._parameters.unsubscribe(names)
            case messages.SubscribeGraph():
                self._connections = {}
                self._guest.run(self._look())
            case messages.UnsubscribeGraph():
                self._connections = None
            case messages.FetchAsset(uri, number):
                self._guest.run(self._answer(self._fetching, partial(self._fetch, uri, number)), size)

    def _subscribe(self, subscription: messages.Subscription) -> None:
        self._subscriptions.add(subscription, self._topics.by_number.get(subscription.channelId))

    def _each(self, items: Iterable[T], handle: Callable[[T], None]) -> None:
        """Handle the items of a message; report the errors of those that are refused."""
        refused: list[RceError] = []
        for item in items:
            try:
                handle(item)
            except RceError as error:
                refused.append(error)
        for each in refused[:MAX_REPORTED]:
            self.report(each)
        if (more := len(refused) - MAX_REPORTED) > 0:
            self.report(InvalidRequest(f"{more} more items of the message were refused"))

    async def _answer(self, turns: asyncio.Semaphore, answer: Callable[[], Awaitable[None]]) -> None:
        """Give an answer when it is its turn, which lasts until the client has read enough."""
        async with turns:
            await answer()
            await self._guest.wait_for_room()

    async def _fetch(self, uri: str, number: int) -> None:
        try:
            frame = messages.asset(number, await self._guest.view.asset(uri))
        except RceError as error:
            frame = messages.asset_error(number, str(error))
        self._guest.send(frame)

    def report(self, error: RceError) -> None:
        """Count an error of the client and send it."""
        errors.add("foxglove", error.info.code)
        self._guest.send(messages.text(op="status", level=ERROR, message=str(error)))
        self._bad.count(error)

    # --- what there is ------------------------------------------------------------------------------------------------

    async def _watch(self) -> None:
        while True:
            await self._look()
            await asyncio.sleep(INTERVAL)

    async def _look(self) -> None:
        try:
            graph = await self._guest.view.present_graph()
            async with self._looking:  # one after the other: a type may have to be asked for
                await self._compare(graph)
        except RceError as error:  # the environment is away, or the client has too much in progress: look again later
            log.info("the graph for {client} cannot be shown: {error}", client=self._guest.name, error=str(error))

    async def _compare(self, graph: RosGraph) -> None:
        topics = await self._topics.update(graph)
        services = await self._services.update(graph)
        for number in topics.removed:
            self._subscriptions.remove_channel(number)
        records = [offers.channel(*each) for each in topics.added.items()]
        self._tell("unadvertise", "channelIds", topics.removed)
        self._tell("advertise", "channels", records)
        self._tell("unadvertiseServices", "serviceIds", services.removed)
        self._tell("advertiseServices", "services", [offers.service(*each) for each in services.added.items()])
        if self._connections is not None:
            self._tell_connections(graph, self._connections)
        self._playback.update(graph)  # last, because it may raise LimitExceeded

    def _tell(self, op: str, field: str, items: list[int] | list[dict[str, object]]) -> None:
        if items:
            self._guest.send(messages.text(op=op, **{field: items}))

    def _tell_connections(self, graph: RosGraph, known: Connections) -> None:
        found = offers.connections(graph)
        update = offers.graph_update(found, known)
        if any(update.values()) or not known:
            self._connections = found
            self._guest.send(messages.text(op="connectionGraphUpdate", **update))
