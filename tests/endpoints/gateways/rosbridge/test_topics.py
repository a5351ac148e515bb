"""Topics of a client of rosbridge."""

from __future__ import annotations

import base64
import json
from typing import Any

import cbor2
import cv2
import numpy as np
import pytest
from msgspec import Raw

from endpoints.gateways.rosbridge.operations import Advertise, Publish, Subscribe, Unadvertise, Unsubscribe
from endpoints.gateways.rosbridge.topics import MAX_IDS, Publications, Subscriptions, _Subscription, find_topic_type
from rce.control.calls.watching import RosGraph, RosName
from rce.errors import InvalidRequest, LimitExceeded, NotFound, RceError
from rce.protocol.messages import Decimation, Delivery
from tests.support.endpoints.fake_guest import FakeGuest, FakePeer

STRING, CLOUD = "std_msgs/String", "sensor_msgs/PointCloud2"
ONE, TWO = Raw(b'"one"'), Raw(b'"two"')
HELLO = Raw(b'{"data":"hello"}')


@pytest.fixture
async def guest() -> FakeGuest:
    return FakeGuest()


@pytest.fixture
def peer() -> FakePeer:
    return FakePeer({"/known": STRING})


@pytest.fixture
def publications(guest: FakeGuest, peer: FakePeer) -> Publications:
    return Publications(guest.as_guest(), peer)


@pytest.fixture
def subscriptions(guest: FakeGuest, peer: FakePeer) -> Subscriptions:
    return Subscriptions(guest.as_guest(), peer)


async def test_messages_are_published(guest: FakeGuest, publications: Publications) -> None:
    publications.advertise(Advertise(topic="/a", type=STRING, latch=True, queue_size=3))
    publications.publish(Publish(topic="/a", msg=HELLO))
    assert guest.sent == [("/a", "", {"data": "hello"}, {})]
    qos = guest.options["u0"]["qos"]
    assert (qos.durability, qos.depth) == ("transient_local", 3)


async def test_client_is_not_read_until_its_topic_is_ready(
    guest: FakeGuest, peer: FakePeer, publications: Publications
) -> None:
    guest.auto = False
    publications.advertise(Advertise(topic="/a", type=STRING))
    publications.publish(Publish(topic="/a", msg=HELLO))
    use = guest.uses["PublisherInterface", "/a"]
    assert peer.paused is use.ready
    assert not guest.sent
    use.ready.set_result(None)
    await guest.finish()
    assert len(guest.sent) == 1


async def test_topic_is_used_until_its_last_id_is_gone(guest: FakeGuest, publications: Publications) -> None:
    for id in (ONE, TWO):
        publications.advertise(Advertise(topic="/a", type=STRING, id=id))
    assert len(guest.uses) == 1
    publications.unadvertise(Unadvertise(topic="/a", id=ONE))
    assert not guest.dropped
    publications.unadvertise(Unadvertise(topic="/a", id=TWO))
    assert guest.dropped == ["/a"]
    publications.unadvertise(Unadvertise(topic="/a"))


async def test_type_of_a_topic_that_exists_is_known(
    guest: FakeGuest, peer: FakePeer, publications: Publications
) -> None:
    publications.publish(Publish(topic="/known", msg=HELLO))
    publications.publish(Publish(topic="/unknown", msg=HELLO))
    await guest.finish()
    assert [address for address, *_ in guest.sent] == ["/known"]
    assert peer.errors == [("/unknown has no type", None)]


async def test_topic_is_advertised_by_a_message_with_a_type(guest: FakeGuest, publications: Publications) -> None:
    publications.publish(Publish(topic="/a", type=STRING, id=ONE, msg=HELLO))
    publications.publish(Publish(topic="/a", type=STRING, id=TWO, msg=HELLO))
    assert [address for address, *_ in guest.sent] == ["/a", "/a"]
    publications.unadvertise(Unadvertise(topic="/a", id=ONE))
    assert guest.dropped == ["/a"]


async def test_other_type_for_a_topic_in_use_is_refused(
    publications: Publications, subscriptions: Subscriptions
) -> None:
    publications.advertise(Advertise(topic="/a", type=STRING))
    with pytest.raises(InvalidRequest, match="already"):
        publications.advertise(Advertise(topic="/a", type="std_msgs/Bool"))
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING))
    with pytest.raises(InvalidRequest, match="already"):
        subscriptions.subscribe(Subscribe(topic="/a", type="std_msgs/Bool"))


async def test_failure_is_reported_with_the_id(
    guest: FakeGuest, peer: FakePeer, publications: Publications, subscriptions: Subscriptions
) -> None:
    guest.fails = RceError("no such environment")
    publications.advertise(Advertise(topic="/a", type=STRING, id=ONE))
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=TWO))
    await guest.finish()
    assert peer.errors == [("no such environment", "one"), ("no such environment", "two")]


async def test_subscriptions_of_a_topic_share_one_use(guest: FakeGuest, subscriptions: Subscriptions) -> None:
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=ONE))
    subscriptions.subscribe(Subscribe(topic="/a", type="std_msgs/msg/String", id=TWO))
    (use,) = guest.uses.values()
    assert guest.deliver(use, {"data": "x"}) == [{"op": "publish", "topic": "/a", "msg": {"data": "x"}}]
    subscriptions.unsubscribe(Unsubscribe(topic="/a", id=ONE))
    assert not guest.dropped
    subscriptions.unsubscribe(Unsubscribe(topic="/a", id=TWO))
    assert guest.dropped == ["/a"]


@pytest.mark.parametrize(
    ("one", "two", "merged"),
    [
        (("a.x",), ("b",), ("a.x", "b")),
        (("a.x",), None, ()),
        ((), ("b",), ()),
    ],
)
def test_subscriptions_get_the_fields_that_any_of_them_wants(
    one: tuple[str, ...], two: tuple[str, ...] | None, merged: tuple[str, ...]
) -> None:
    found = _Subscription("/a", STRING)
    found.asked = {b"1": Subscribe(topic="/a", fields=one), b"2": Subscribe(topic="/a", fields=two)}
    assert found.merged().fields == merged


async def test_change_of_the_fields_begins_another_use(guest: FakeGuest, subscriptions: Subscriptions) -> None:
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=ONE, fields=("data",)))
    assert guest.options["u0"]["delivery"] == Delivery(fields=("data",))
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=TWO))
    assert guest.options["u1"]["delivery"] == Delivery()


def test_subscriptions_get_the_finest_decimation_of_them() -> None:
    def merged(*decimations: Decimation | None) -> Decimation | None:
        asked = {b"%d" % n: Subscribe(topic="/a", decimate=each) for n, each in enumerate(decimations)}
        return _Subscription("/a", STRING, asked).merged().decimate

    assert merged(Decimation(4, (320, 100)), Decimation(2, (160, 240))) == Decimation(2, (320, 240))
    assert merged(Decimation(4, (320, 100)), Decimation(2)) == Decimation(2)
    assert merged(Decimation(4), None) == Decimation()


async def test_subscriptions_get_the_lowest_throttle_and_the_longest_queue(subscriptions: Subscriptions) -> None:
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=ONE, throttle_rate=100, queue_length=1))
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=TWO, throttle_rate=50, queue_length=9))
    merged = subscriptions._by_topic["/a"].merged()
    assert (merged.throttle_rate, merged.queue_length) == (50, 9)


async def test_throttle_holds_from_the_first_message(guest: FakeGuest, subscriptions: Subscriptions) -> None:
    subscriptions.subscribe(Subscribe(topic="/slow", type=STRING, throttle_rate=500, queue_length=1))
    subscriptions.subscribe(Subscribe(topic="/all", type=STRING, throttle_rate=0.5))
    assert [guest.options[tag]["delivery"].rate for tag in ("u0", "u1")] == [2.0, 0.0]


async def test_new_throttle_keeps_the_interface(guest: FakeGuest, subscriptions: Subscriptions) -> None:
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, throttle_rate=500))
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, throttle_rate=100, id=ONE))
    assert list(guest.options) == ["u0"]


async def test_compression_decides_the_interface(guest: FakeGuest, subscriptions: Subscriptions) -> None:
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING))
    assert guest.options["u0"]["format"] == "rosbridge"
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=ONE, compression="cbor"))
    assert guest.options["u1"]["format"] == "cbor"
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=TWO, compression="cbor-raw"))
    assert guest.options["u2"]["form"] == "Forwarder"
    (frame,) = guest.deliver(guest.uses["SubscriberInterface", "/a"], "id", blob=b"\0\1\0\0")
    assert cbor2.loads(frame)["msg"]["bytes"] == b"\0\1\0\0"


@pytest.mark.parametrize("compression", ["none", "png", "cbor"])
async def test_packets_come_with_their_data(guest: FakeGuest, subscriptions: Subscriptions, compression: Any) -> None:
    subscriptions.subscribe(Subscribe(topic="/a", type=CLOUD, compression=compression, codec="draco"))
    assert guest.options["u0"]["codec"] == "draco"
    head = {"header": {"frame_id": "map"}, "codec": "draco", "width": 7, "data*": "0" * 32}
    (frame,) = guest.deliver(guest.uses["SubscriberInterface", "/a"], head, blob=b"\0\1")
    if compression == "png":
        pixels = cv2.imdecode(np.frombuffer(base64.b64decode(frame["data"]), np.uint8), cv2.IMREAD_COLOR_RGB)
        frame = json.loads(pixels.tobytes())
    message = (cbor2.loads(frame) if compression == "cbor" else frame)["msg"]
    data = b"\0\1" if compression == "cbor" else base64.b64encode(b"\0\1").decode()
    assert message == {"header": {"frame_id": "map"}, "codec": "draco", "width": 7, "data": data}


async def test_subscriptions_of_a_topic_have_one_codec(guest: FakeGuest, subscriptions: Subscriptions) -> None:
    subscriptions.subscribe(Subscribe(topic="/a", type=CLOUD, id=ONE, codec="draco"))
    subscriptions.subscribe(Subscribe(topic="/a", type=CLOUD, id=TWO, codec="draco"))
    with pytest.raises(InvalidRequest, match="codec 'draco': use the same one"):
        subscriptions.subscribe(Subscribe(topic="/a", type=CLOUD, id=TWO))
    subscriptions.subscribe(Subscribe(topic="/c", type=CLOUD, id=ONE))
    with pytest.raises(InvalidRequest, match="with no codec: use the same one"):
        subscriptions.subscribe(Subscribe(topic="/c", type=CLOUD, id=TWO, codec="draco"))
    with pytest.raises(InvalidRequest, match="without a codec: use cbor"):
        subscriptions.subscribe(Subscribe(topic="/b", type=CLOUD, codec="draco", compression="cbor-raw"))
    subscriptions.unsubscribe(Unsubscribe(topic="/a", id=ONE))
    subscriptions.subscribe(Subscribe(topic="/a", type=CLOUD, id=TWO, codec="quantised"))
    assert [each["codec"] for each in guest.options.values()] == ["draco", "", "quantised"]


async def test_subscription_without_a_type_takes_that_of_the_topic(
    guest: FakeGuest, peer: FakePeer, subscriptions: Subscriptions
) -> None:
    subscriptions.subscribe(Subscribe(topic="/known"))
    subscriptions.subscribe(Subscribe(topic="/unknown", id=ONE))
    subscriptions.unsubscribe(Unsubscribe(topic="/nothing"))
    await guest.finish()
    assert [address for _, address in guest.uses] == ["/known"]
    assert peer.errors == [("/unknown has no type", "one")]


async def test_type_comes_from_the_graph() -> None:
    guest = FakeGuest(RosGraph([RosName("/a", [STRING])], []))
    assert await find_topic_type(guest.as_guest(), "/a") == STRING
    with pytest.raises(NotFound, match="/b has no type"):
        await find_topic_type(guest.as_guest(), "/b")


async def test_ids_of_a_topic_are_bounded(publications: Publications, subscriptions: Subscriptions) -> None:
    for number in range(MAX_IDS):
        publications.advertise(Advertise(topic="/a", type=STRING, id=Raw(b"%d" % number)))
        subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=Raw(b"%d" % number)))
    with pytest.raises(LimitExceeded):
        publications.advertise(Advertise(topic="/a", type=STRING, id=ONE))
    with pytest.raises(LimitExceeded):
        subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=ONE))
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=Raw(b"1"), queue_length=3))


async def test_type_of_a_later_subscription_serves_an_earlier_one(
    guest: FakeGuest, peer: FakePeer, subscriptions: Subscriptions
) -> None:
    subscriptions.subscribe(Subscribe(topic="/unknown", id=ONE))
    subscriptions.subscribe(Subscribe(topic="/unknown", type=STRING, id=TWO))
    await guest.finish()
    assert [use.type for use in guest.uses.values()] == [STRING]
    assert not peer.errors
    subscriptions.unsubscribe(Unsubscribe(topic="/unknown", id=TWO))
    assert not guest.dropped


async def test_topic_whose_use_ended_is_subscribed_to_anew(
    guest: FakeGuest, peer: FakePeer, subscriptions: Subscriptions
) -> None:
    subscriptions.subscribe(Subscribe(topic="/r/a", type=STRING, id=ONE))
    guest.uses["SubscriberInterface", "/r/a"].end(NotFound("the robot removed it"))
    await guest.finish()
    assert peer.errors == [("the robot removed it", "one")]
    subscriptions.subscribe(Subscribe(topic="/r/a", type=STRING, id=ONE))
    assert len(guest.options) == 2


async def test_topic_whose_use_ended_is_advertised_anew(
    guest: FakeGuest, peer: FakePeer, publications: Publications
) -> None:
    publications.advertise(Advertise(topic="/r/a", type=STRING, id=ONE))
    guest.uses["PublisherInterface", "/r/a"].end(NotFound("the robot removed it"))
    await guest.finish()
    assert peer.errors == [("the robot removed it", "one")]
    publications.advertise(Advertise(topic="/r/a", type=STRING, id=ONE))
    assert len(guest.options) == 2


async def test_subscription_that_is_refused_leaves_what_there_was(
    guest: FakeGuest, subscriptions: Subscriptions
) -> None:
    guest.full = True
    with pytest.raises(LimitExceeded):
        subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=ONE))
    guest.full = False
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=ONE))
    guest.full = True
    with pytest.raises(LimitExceeded):
        subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=TWO, compression="cbor"))
    assert guest.dropped == []
    guest.full = False
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=TWO, compression="cbor"))
    assert guest.dropped == ["/a"], "one use has taken the place of the other"
    assert guest.options["u1"]["format"] == "cbor"


async def test_change_of_a_topic_that_is_refused_is_made_with_the_next_one(
    guest: FakeGuest, subscriptions: Subscriptions
) -> None:
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=ONE))
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=TWO, compression="cbor"))
    guest.full = True
    with pytest.raises(LimitExceeded):
        subscriptions.unsubscribe(Unsubscribe(topic="/a", id=TWO))
    assert len(guest.dropped) == 1, "the use by cbor goes on"
    guest.full = False
    subscriptions.subscribe(Subscribe(topic="/a", type=STRING, id=ONE))
    assert [each["format"] for each in guest.options.values()] == ["rosbridge", "cbor", "rosbridge"]
