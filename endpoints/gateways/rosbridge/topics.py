"""Topics of a client: what it publishes and what it subscribes to."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import msgspec
from msgspec import Raw

from endpoints.gateways.guest import Guest
from endpoints.gateways.rosbridge import encoding
from endpoints.gateways.rosbridge.encoding import Form
from endpoints.gateways.rosbridge.operations import Advertise, Id, Publish, Subscribe, Unadvertise, Unsubscribe, key
from endpoints.gateways.rosbridge.peer import Peer
from endpoints.gateways.uses import PUBLISH, SUBSCRIBE, Arrived, Frame, Use
from endpoints.robot.interfaces import Publisher
from endpoints.robot.pace import SHORTEST
from rce.errors import InvalidRequest, LimitExceeded, NotFound, RceError
from rce.protocol.messages import Decimation, Delivery, Qos
from rce.protocol.names import parse_type

MAX_DEPTH = 10_000
MAX_IDS = 1000  # of one topic
FORMATS: dict[str, tuple[Literal["Converter", "Forwarder"], str]] = {
    "cbor": ("Converter", "cbor"),
    "cbor-raw": ("Forwarder", "cdr"),
}


@dataclass
class _Publication:
    use: Use
    ids: set[bytes]
    waiting: list[Raw] = field(default_factory=list)


class Publications:
    """Topics that a client publishes on; a topic is used as long as one of its ids is advertised."""

    def __init__(self, guest: Guest, peer: Peer) -> None:
        self._guest = guest
        self._peer = peer
        self._by_topic: dict[str, _Publication] = {}

    def advertise(self, op: Advertise) -> None:
        """Begin to publish on a topic; raises InvalidRequest or LimitExceeded."""
        present = self._by_topic.get(op.topic)
        if present is not None:
            if parse_type(present.use.type) != parse_type(op.type):
                raise InvalidRequest(f"topic {op.topic} is advertised as {present.use.type} already")
            _check_ids(op.topic, present.ids, op.id)
            present.ids.add(key(op.id))
            return
        if not op.type:
            self._guest.run(self._infer(op))
            return
        parse_type(op.type)
        self._add(op, op.type)

    def _add(self, op: Advertise, type: str) -> _Publication:
        depth = min(max(op.queue_size or 0, 0), MAX_DEPTH)
        qos = Qos(durability="transient_local" if op.latch else "auto", depth=depth)
        use = self._guest.use(PUBLISH, op.topic, type, _nothing, lambda _, error: self._peer.report(error), qos=qos)
        added = self._by_topic[op.topic] = _Publication(use, {key(op.id)})
        use.ready.add_done_callback(lambda done: self._ready(added, done))
        use.on_end(lambda error: self._ended(op, added, error))
        return added

    async def _infer(self, op: Advertise) -> None:
        try:
            type = await self._peer.type_of_topic(op.topic)
            if op.topic not in self._by_topic:
                self._add(op, type)
        except RceError as error:
            self._peer.report(error, op.id)

    def _ready(self, publication: _Publication, done: asyncio.Future[None]) -> None:
        waiting, publication.waiting = publication.waiting, []
        if done.cancelled() or done.exception() is not None:
            return
        for message in waiting:
            self._send(publication, message)

    def _ended(self, op: Advertise, publication: _Publication, error: RceError) -> None:
        if self._by_topic.get(op.topic) is publication:
            del self._by_topic[op.topic]
        self._peer.report(error, op.id)

    def unadvertise(self, op: Unadvertise) -> None:
        """Publish no more on a topic, once none of its ids is advertised; without an id at once."""
        found = self._by_topic.get(op.topic)
        if found is None:
            return
        found.ids.discard(key(op.id))
        if not found.ids or not key(op.id):
            del self._by_topic[op.topic]
            if found.use.ready.done():
                self._guest.drop(found.use)
            else:  # what was published before is sent
                found.use.ready.add_done_callback(lambda _: self._guest.drop(found.use))

    def publish(self, op: Publish) -> None:
        """Publish a message; on a topic that is not advertised, it gives the type or the topic has one already.

        Raises:
            InvalidRequest: The type is malformed.
            LimitExceeded: Too many operations are in progress.
        """
        found = self._by_topic.get(op.topic)
        if found is None and op.type:
            self.advertise(Advertise(topic=op.topic, type=op.type, id=op.id))
            found = self._by_topic.get(op.topic)
        if found is None:
            self._guest.run(self._publish_unadvertised(op), len(memoryview(op.msg)))
        elif found.use.ready.done():
            self._send(found, op.msg)
        else:  # nothing more is read meanwhile, so that what waits is bounded by what was read already
            found.waiting.append(op.msg)
            self._peer.pause_until(found.use.ready)

    async def _publish_unadvertised(self, op: Publish) -> None:
        await self._infer(Advertise(topic=op.topic, id=op.id))
        if op.topic in self._by_topic:
            self.publish(op)

    def _send(self, publication: _Publication, message: Raw) -> None:
        self._guest.data(publication.use, "", message, self._peer.report)


class _Options(NamedTuple):
    """Options of the use of a topic."""

    form: Literal["Converter", "Forwarder"]
    format: str
    delivery: Delivery
    codec: str


def _options(merged: Subscribe) -> _Options:
    form, format = FORMATS.get(merged.compression or "none", ("Converter", "rosbridge"))
    delivery = Delivery(fields=merged.fields or (), decimate=merged.decimate or Decimation())
    return _Options(form, format, delivery, merged.codec or "")


@dataclass
class _Subscription:
    """Subscriptions of one topic by their ids, which share one use."""

    topic: str
    type: str
    asked: dict[bytes, Subscribe] = field(default_factory=dict)
    use: Use | None = None
    form: Form = encoding.PLAIN
    options: _Options | None = None

    def merged(self) -> Subscribe:
        """Return what all of them get: the fastest, longest and least fragmented of what they asked for."""
        every = list(self.asked.values())
        sizes = [each.fragment_size for each in every if each.fragment_size]
        kinds = {each.compression or "none" for each in every}
        return Subscribe(
            topic=self.topic,
            throttle_rate=min(max(each.throttle_rate or 0, 0) for each in every),
            queue_length=max(max(each.queue_length or 0, 0) for each in every),
            fragment_size=min(sizes, default=0),
            compression=next(kind for kind in ("cbor-raw", "cbor", "png", "none") if kind in kinds),
            fields=_merged_fields(every),
            decimate=_merged_decimation(every),
            codec=every[0].codec,
        )


def _merged_fields(every: Sequence[Subscribe]) -> tuple[str, ...]:
    """Return the fields that any of them wants; empty for all."""
    if not all(each.fields for each in every):
        return ()
    return tuple(sorted({name for each in every for name in each.fields or ()}))


def _merged_decimation(every: Sequence[Subscribe]) -> Decimation:
    """Return the finest decimation."""
    asked = [each.decimate or Decimation() for each in every]
    sizes = [each.size for each in asked if each.size is not None]
    largest = (max(width for width, _ in sizes), max(height for _, height in sizes)) if sizes else None
    return Decimation(min(each.step for each in asked), largest if len(sizes) == len(asked) else None)


class Subscriptions:
    """Topics that a client subscribes to."""

    def __init__(self, guest: Guest, peer: Peer) -> None:
        self._guest = guest
        self._peer = peer
        self._by_topic: dict[str, _Subscription] = {}

    def subscribe(self, op: Subscribe) -> None:
        """Subscribe to a topic, or change an earlier subscription of the same id.

        Raises:
            InvalidRequest: The topic is subscribed to as another type or with another codec.
            LimitExceeded: It is subscribed to with too many ids, or too many operations are in progress.
        """
        if op.type:
            parse_type(op.type)
        self._guest.check_room()  # before anything is changed
        found = self._by_topic.get(op.topic)
        _check_codec(op, found.asked if found is not None else {})
        if found is None:
            found = self._by_topic[op.topic] = _Subscription(op.topic, op.type or "")
        elif op.type and found.type and parse_type(op.type) != parse_type(found.type):
            raise InvalidRequest(f"topic {op.topic} is subscribed to as {found.type} already")
        _check_ids(op.topic, found.asked, op.id)
        found.type = found.type or op.type or ""
        found.asked[key(op.id)] = op
        if found.type:
            self._update(found)
        else:
            self._guest.run(self._infer(found, op))

    async def _infer(self, subscription: _Subscription, op: Subscribe) -> None:
        try:
            found = await self._peer.type_of_topic(op.topic)
            subscription.type = subscription.type or found  # another operation may have given it meanwhile
            if self._by_topic.get(op.topic) is subscription:
                self._update(subscription)
        except RceError as error:
            if subscription.use is not None:
                return
            if self._by_topic.get(op.topic) is subscription:
                del self._by_topic[op.topic]
            self._peer.report(error, op.id)

    def unsubscribe(self, op: Unsubscribe) -> None:
        """End one subscription, or without an id all of the topic."""
        found = self._by_topic.get(op.topic)
        if found is None:
            return
        found.asked.pop(key(op.id), None)
        if found.asked and key(op.id):
            if found.type:
                self._update(found)
            return
        del self._by_topic[op.topic]
        if found.use is not None:
            self._guest.drop(found.use)

    def _update(self, subscription: _Subscription) -> None:
        merged = subscription.merged()
        options, old = _options(merged), subscription.use
        if old is None or options != subscription.options:
            self._begin(subscription, options)
            subscription.options = options
            if old is not None:
                self._guest.drop(old)
        subscription.form = Form(merged.compression or "none", merged.fragment_size or 0)
        assert subscription.use is not None
        self._pace(subscription.use, merged)

    def _begin(self, subscription: _Subscription, options: _Options) -> None:
        """Make a use that has the present pace from its first message on; `_pace` changes it later."""
        fields = {"op": "publish", "topic": subscription.topic}
        interval = _interval(subscription.merged())
        delivery = msgspec.structs.replace(options.delivery, rate=1 / interval if interval >= SHORTEST else 0.0)

        def receive(arrived: Arrived) -> Sequence[Frame]:
            if arrived.blob is None:
                return encoding.with_value("msg", arrived.value, subscription.form, **fields)
            if options.codec:
                return encoding.packet("msg", arrived.value, arrived.blob, subscription.form, **fields)
            if options.format == "cbor":
                return encoding.cbor("msg", arrived.blob, **fields)
            return encoding.cbor_raw(arrived.blob, **fields)

        use = self._guest.use(
            SUBSCRIBE,
            subscription.topic,
            subscription.type,
            receive,
            lambda _, error: self._peer.report(error),
            **options._replace(delivery=delivery)._asdict(),
        )
        subscription.use = use
        use.ready.add_done_callback(lambda done: self._ready(subscription, use, done))
        use.on_end(lambda error: self._ended(subscription, use, error))

    def _ready(self, subscription: _Subscription, use: Use, done: asyncio.Future[None]) -> None:
        if not done.cancelled() and done.exception() is None and self._is_present(subscription):
            self._pace(use, subscription.merged())

    def _ended(self, subscription: _Subscription, use: Use, error: RceError) -> None:
        if subscription.use is use and self._is_present(subscription):
            del self._by_topic[subscription.topic]
            self._peer.report(error, next(iter(subscription.asked.values())).id)

    def _is_present(self, subscription: _Subscription) -> bool:
        return self._by_topic.get(subscription.topic) is subscription

    def _pace(self, use: Use, merged: Subscribe) -> None:
        interface = self._guest.interface(use)
        if isinstance(interface, Publisher):
            interface.set_pace(_interval(merged), min(merged.queue_length or 0, MAX_DEPTH))


def _interval(merged: Subscribe) -> float:
    """Return the least time between two messages, in seconds."""
    return (merged.throttle_rate or 0) / 1000


def _check_ids(topic: str, ids: Collection[bytes], id: Id) -> None:
    if len(ids) >= MAX_IDS and key(id) not in ids:
        raise LimitExceeded(f"topic {topic} has {MAX_IDS} ids already: use one of them")


def _check_codec(op: Subscribe, asked: Mapping[bytes, Subscribe]) -> None:
    """Check that a subscription shares the codec of the others of its topic; raises InvalidRequest."""
    if op.codec and op.compression == "cbor-raw":
        raise InvalidRequest(f"topic {op.topic}: cbor-raw passes the bytes of ROS without a codec: use cbor")
    for id, other in asked.items():
        if id != key(op.id) and (other.codec or "") != (op.codec or ""):
            present = f"the codec {other.codec!r}" if other.codec else "no codec"
            raise InvalidRequest(f"topic {op.topic} is subscribed to with {present}: use the same one")


def _nothing(_: Arrived) -> Sequence[Frame]:
    return ()


async def find_topic_type(guest: Guest, topic: str) -> str:
    """Return the type of a topic of the environment; raise NotFound if it has none."""
    for age in (1.0, 0.0):
        for each in (await guest.view.graph(age)).topics:
            if each.name == topic:
                return each.types[0]
    raise NotFound(f"topic {topic[:200]} has no type yet: give its type, or begin to publish it", field="type")
