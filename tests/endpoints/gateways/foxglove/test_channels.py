"""Channels that a client subscribes to and publishes on."""

from __future__ import annotations

import pytest

from endpoints.gateways.foxglove.channels import MAX_SUBSCRIPTIONS, Publications, Subscriptions
from endpoints.gateways.foxglove.messages import ClientChannel, ClientMessage, Subscription
from endpoints.gateways.foxglove.offers import Offer
from endpoints.gateways.foxglove.options import Options
from rce.codecs.names import FOXGLOVE, IMAGE
from rce.errors import InvalidRequest, LimitExceeded, NotFound, RceError
from rce.protocol.messages import Delivery
from tests.support.endpoints.fake_guest import FakeGuest, FakePeer

OFFER = Offer("/chat", "std_msgs/String", ("string data\n",))
OPTIONS = Options({IMAGE: Delivery(rate=5)}, ("h264",))


@pytest.fixture
def subscriptions(guest: FakeGuest, peer: FakePeer) -> Subscriptions:
    return Subscriptions(guest.as_guest(), OPTIONS, peer.report)


@pytest.fixture
def publications(guest: FakeGuest, peer: FakePeer) -> Publications:
    return Publications(guest.as_guest(), peer.report)


async def test_subscriptions_of_a_channel_share_one_use(guest: FakeGuest, subscriptions: Subscriptions) -> None:
    subscriptions.add(Subscription(1, 5), OFFER)
    subscriptions.add(Subscription(2, 5), OFFER)
    (use,) = guest.uses.values()
    assert guest.options["u0"] == {"form": "Forwarder", "format": "cdr", "delivery": Delivery()}
    frames = guest.deliver(use, "id", blob=b"cdr")
    assert [(frame[1], frame[13:]) for frame in frames] == [(1, b"cdr"), (2, b"cdr")]
    subscriptions.remove(1)
    assert not guest.dropped
    subscriptions.remove(2)
    subscriptions.remove(2)
    assert guest.dropped == ["/chat"]


async def test_options_reduce_what_a_channel_sends(guest: FakeGuest, subscriptions: Subscriptions) -> None:
    subscriptions.add(Subscription(1, 5), Offer("/camera", "sensor_msgs/Image", ("",)))
    assert guest.options["u0"]["delivery"] == Delivery(rate=5)


async def test_channel_of_packets_uses_the_topic_with_a_codec(guest: FakeGuest, subscriptions: Subscriptions) -> None:
    subscriptions.add(Subscription(1, 5), Offer("/camera/h264", FOXGLOVE, ("",), "h264"))
    (use,) = guest.uses.values()
    assert (use.address, use.type) == ("/camera", IMAGE)
    assert guest.options["u0"] == {"delivery": Delivery(rate=5), "codec": "h264"}
    (frame,) = guest.deliver(use, {"header": {}, "data*": "0" * 32}, blob=b"video")
    assert (frame[1], b"video" in frame[13:]) == (1, True)
    assert not guest.deliver(use, {})


async def test_channel_that_is_not_offered_is_refused(subscriptions: Subscriptions) -> None:
    with pytest.raises(InvalidRequest, match="not offered"):
        subscriptions.add(Subscription(1, 5), None)
    for number in range(MAX_SUBSCRIPTIONS):
        subscriptions.add(Subscription(number, 5), OFFER)
    with pytest.raises(InvalidRequest, match="use a new id"):
        subscriptions.add(Subscription(1, 5), OFFER)
    with pytest.raises(LimitExceeded, match="subscriptions already"):
        subscriptions.add(Subscription(99, 5), OFFER)


async def test_subscription_that_fails_is_reported(
    guest: FakeGuest, peer: FakePeer, subscriptions: Subscriptions
) -> None:
    guest.fails = RceError("no environment")
    subscriptions.add(Subscription(1, 5), OFFER)
    await guest.finish()
    assert peer.errors == [("no environment", None)]


async def test_messages_are_published_as_cdr_or_json(guest: FakeGuest, publications: Publications) -> None:
    publications.add(ClientChannel(1, "chat", "cdr", "std_msgs/msg/String"))
    publications.add(ClientChannel(2, "/chat", "json", "std_msgs/String"))
    publications.publish(ClientMessage(1, memoryview(b"\0\1\0\0")))
    publications.publish(ClientMessage(2, memoryview(b'{"data":"x"}')))
    assert [(address, value) for address, _, value, _ in guest.sent] == [
        ("/chat", b"\0\1\0\0"),
        ("/chat", {"data": "x"}),
    ]
    assert [each["format"] for each in guest.options.values()] == ["cdr", "rosbridge"]
    publications.remove(1)
    with pytest.raises(InvalidRequest, match="channel 1 is not advertised"):
        publications.publish(ClientMessage(1, memoryview(b"")))


async def test_client_is_not_read_until_its_channel_is_ready(guest: FakeGuest, publications: Publications) -> None:
    guest.auto = False
    publications.add(ClientChannel(1, "/chat", "cdr", "std_msgs/String"))
    publications.publish(ClientMessage(1, memoryview(b"cdr")))
    use = guest.uses["PublisherInterface", "/chat"]
    assert guest.paused is use.ready
    use.ready.set_result(None)
    await guest.finish()
    assert len(guest.sent) == 1


async def test_encoding_or_id_that_cannot_be_used_is_refused(publications: Publications) -> None:
    with pytest.raises(InvalidRequest, match="use cdr or json"):
        publications.add(ClientChannel(1, "/chat", "protobuf", "std_msgs/String"))
    publications.add(ClientChannel(1, "/chat", "cdr", "std_msgs/String"))
    with pytest.raises(InvalidRequest, match="already"):
        publications.add(ClientChannel(1, "/chat", "cdr", "std_msgs/String"))


async def test_channel_outlives_the_failure_of_an_earlier_one_with_its_id(
    guest: FakeGuest, peer: FakePeer, publications: Publications
) -> None:
    guest.auto = False
    publications.add(ClientChannel(1, "/odd", "cdr", "odd_msgs/Odd"))
    publications.remove(1)
    publications.add(ClientChannel(1, "/chat", "cdr", "std_msgs/String"))
    publications.publish(ClientMessage(1, memoryview(b"cdr")))
    guest.uses["PublisherInterface", "/odd"].end(RceError("no such type"))
    await guest.finish()
    guest.uses["PublisherInterface", "/chat"].ready.set_result(None)
    await guest.finish()
    assert [address for address, *_ in guest.sent] == ["/chat"]
    assert peer.errors == [("no such type", None)]


async def test_channel_whose_use_ended_may_be_used_anew(
    guest: FakeGuest, peer: FakePeer, subscriptions: Subscriptions, publications: Publications
) -> None:
    subscriptions.add(Subscription(1, 5), OFFER)
    publications.add(ClientChannel(3, "/chat", "json", "std_msgs/String"))
    for use in guest.uses.values():
        use.end(NotFound("the robot removed it"))
    await guest.finish()
    assert [error for error, _ in peer.errors] == ["the robot removed it"] * 2
    subscriptions.add(Subscription(1, 5), OFFER)
    publications.add(ClientChannel(3, "/chat", "json", "std_msgs/String"))
    assert len(guest.options) == 4


async def test_subscription_that_is_refused_leaves_nothing(guest: FakeGuest, subscriptions: Subscriptions) -> None:
    guest.full = True
    with pytest.raises(LimitExceeded):
        subscriptions.add(Subscription(1, 5), OFFER)
    guest.full = False
    subscriptions.add(Subscription(1, 5), OFFER)
    assert len(guest.uses) == 1
