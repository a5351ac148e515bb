"""Channels of a client: those that it subscribes to, and those on which it publishes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence

from msgspec import Raw

from endpoints.gateways.foxglove import messages
from endpoints.gateways.foxglove.messages import ClientChannel, ClientMessage, Subscription
from endpoints.gateways.foxglove.offers import Offer
from endpoints.gateways.foxglove.options import Options
from endpoints.gateways.foxglove.packets import TYPES, Packing
from endpoints.gateways.guest import Guest
from endpoints.gateways.uses import PUBLISH, SUBSCRIBE, Arrived, Frame, Use
from rce.errors import InvalidRequest, LimitExceeded, RceError
from rce.protocol.blobs import Buffer
from rce.protocol.names import parse_type

MAX_SUBSCRIPTIONS = 10  # of one channel, each of which gets every message
Report = Callable[[RceError], None]


class Subscriptions:
    """Channels that a client subscribes to; several subscriptions of a channel share one use."""

    def __init__(self, guest: Guest, options: Options, report: Report) -> None:
        self._guest = guest
        self._options = options
        self._report = report
        self._channels: dict[int, int] = {}  # by subscription
        self._uses: dict[int, Use] = {}  # by channel

    def add(self, subscription: Subscription, offer: Offer | None) -> None:
        """Subscribe to a channel; raises InvalidRequest or LimitExceeded."""
        if offer is None:
            raise InvalidRequest(f"channel {subscription.channelId} is not offered")
        if subscription.id in self._channels:
            raise InvalidRequest(f"subscription {subscription.id} exists already: use a new id")
        if list(self._channels.values()).count(subscription.channelId) >= MAX_SUBSCRIPTIONS:
            raise LimitExceeded(f"channel {subscription.channelId} has {MAX_SUBSCRIPTIONS} subscriptions already")
        number = subscription.channelId
        if number not in self._uses:
            use = self._uses[number] = self._use_packets(number, offer) if offer.codec else self._use(number, offer)
            use.on_end(lambda error: self._ended(number, use, error))
        self._channels[subscription.id] = number

    def _use(self, number: int, offer: Offer) -> Use:
        def receive(arrived: Arrived) -> Sequence[Frame]:
            return () if arrived.blob is None else self._frames(number, arrived.blob)

        delivery = self._options.delivery(offer.type)
        return self._guest.use(
            SUBSCRIBE, offer.name, offer.type, receive, self._failed, form="Forwarder", format="cdr", delivery=delivery
        )

    def _use_packets(self, number: int, offer: Offer) -> Use:
        packing, topic, (type, _) = Packing(offer.codec), offer.name.removesuffix(f"/{offer.codec}"), TYPES[offer.codec]

        def receive(arrived: Arrived) -> Sequence[Frame]:
            return () if arrived.blob is None else self._frames(number, packing.cdr(arrived))

        delivery = self._options.delivery(type)
        return self._guest.use(SUBSCRIBE, topic, type, receive, self._failed, delivery=delivery, codec=offer.codec)

    def _frames(self, number: int, cdr: Buffer) -> Sequence[Frame]:
        return [messages.message_data(id, cdr) for id, channel in self._channels.items() if channel == number]

    def _failed(self, _: str, error: RceError) -> None:
        self._report(error)

    def _ended(self, number: int, use: Use, error: RceError) -> None:
        if self._uses.get(number) is use:
            self.remove_channel(number)
        self._report(error)

    def remove(self, subscription: int) -> None:
        """End a subscription."""
        number = self._channels.pop(subscription, None)
        if number is not None and number not in self._channels.values():
            self.remove_channel(number)

    def remove_channel(self, number: int) -> None:
        """End all subscriptions of a channel."""
        self._channels = {id: channel for id, channel in self._channels.items() if channel != number}
        use = self._uses.pop(number, None)
        if use is not None:
            self._guest.drop(use)


class Publications:
    """Channels on which a client publishes, in CDR or JSON."""

    def __init__(self, guest: Guest, report: Report) -> None:
        self._guest = guest
        self._report = report
        self._uses: dict[int, tuple[Use, bool]] = {}  # by channel; whether it is JSON
        self._waiting: dict[int, list[ClientMessage]] = {}

    def add(self, channel: ClientChannel) -> None:
        """Begin to publish; raises InvalidRequest or LimitExceeded."""
        if channel.id in self._uses:
            raise InvalidRequest(f"channel {channel.id} is advertised already")
        if channel.encoding not in ("cdr", "json"):
            raise InvalidRequest(f"encoding {channel.encoding[:40]!r} is not supported: use cdr or json")
        parse_type(channel.schemaName)
        is_json = channel.encoding == "json"
        use = self._guest.use(
            PUBLISH,
            channel.topic if channel.topic.startswith("/") else f"/{channel.topic}",
            channel.schemaName,
            _nothing,
            lambda _, error: self._report(error),
            form="Converter" if is_json else "Forwarder",
            format="rosbridge" if is_json else "cdr",
        )
        self._uses[channel.id] = use, is_json
        use.ready.add_done_callback(lambda done: self._ready(channel.id, use, done))
        use.on_end(lambda error: self._ended(channel.id, use, error))

    def _ready(self, number: int, use: Use, done: asyncio.Future[None]) -> None:
        waiting = self._waiting.pop(number, []) if self._is_present(number, use) else []
        if done.cancelled() or done.exception() is not None:
            return
        for message in waiting:
            self.publish(message)

    def _ended(self, number: int, use: Use, error: RceError) -> None:
        if self._is_present(number, use):
            del self._uses[number]
        self._report(error)

    def _is_present(self, number: int, use: Use) -> bool:
        return self._uses.get(number, (None, False))[0] is use  # else the client has taken it back

    def publish(self, message: ClientMessage) -> None:
        """Publish a message; raises InvalidRequest."""
        found = self._uses.get(message.channel)
        if found is None:
            raise InvalidRequest(f"channel {message.channel} is not advertised by this client")
        use, is_json = found
        if not use.ready.done():  # nothing more is read meanwhile
            self._waiting.setdefault(message.channel, []).append(message)
            self._guest.pause_reading(use.ready)
            return
        self._guest.data(use, "", Raw(message.payload) if is_json else message.payload, self._report)

    def remove(self, number: int) -> None:
        """Publish no more on a channel."""
        use, _ = self._uses.pop(number, (None, False))
        self._waiting.pop(number, None)
        if use is not None:
            self._guest.drop(use)


def _nothing(_: Arrived) -> Sequence[Frame]:
    return ()
