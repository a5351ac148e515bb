"""Messages that an interface sends over the links to its peers, and its counters."""

from __future__ import annotations

import asyncio

import pytest

from endpoints.data.frames import Message
from endpoints.data.hops import HopRecorder
from endpoints.data.interface import MAX_REQUESTS, Interface, error_of
from endpoints.data.link import Link
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import LimitExceeded, NotConnected, TimedOut
from rce.net.outbox import Owner
from rce.protocol.messages import Qos

ID = "0a" * 16
ANN, BOB, EVE = b"a" * 16, b"b" * 16, b"e" * 16


class FakeLink:
    """Link that records what is sent, and drops messages and is full as the test says."""

    name = "fake"

    def __init__(self) -> None:
        self.opened: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.sent: list[tuple[Message, int | None]] = []
        self.drops = 0
        self.waiting = 0
        self.room: asyncio.Future[None] | None = None

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        self.sent.append((message, keep))
        return self.drops

    def wait_for_room(self, source: bytes) -> asyncio.Future[None] | None:
        return self.room

    def backlog(self, source: bytes) -> int:
        return self.waiting

    def discard(self, source: bytes) -> None: ...

    def pause(self, until: asyncio.Future[None]) -> None: ...

    def close(self) -> None: ...

    def names(self) -> list[str]:
        return [message.msg_id for message, _ in self.sent]


class Plain(Interface):
    def receive(self, message: Message, link: Link) -> None: ...


def interface(qos: Qos | None = None, **peers: FakeLink) -> Plain:
    """Return an interface with peers by their initials and the links to them."""
    made = Plain(InterfaceSpec(ID, "u/r", "tag", "PublisherConverter", "a/B", qos=qos or Qos()), HopRecorder())
    made.peers.update({name.encode() * 16: link for name, link in peers.items()})
    return made


@pytest.fixture
async def links() -> tuple[FakeLink, FakeLink]:
    return FakeLink(), FakeLink()


def message(name: str, payload: bytes = b"", destination: bytes | None = None) -> Message:
    return Message(bytes.fromhex(ID), name, payload, destination)


async def test_peers_behind_one_link_get_one_copy(links: tuple[FakeLink, FakeLink]) -> None:
    near, far = links
    interface(a=near, b=far, e=far).send(message("all"))
    assert (near.names(), far.names()) == (["all"], ["all"])


async def test_addressed_message_goes_to_its_destination_only(links: tuple[FakeLink, FakeLink]) -> None:
    near, far = links
    made = interface(a=near, b=far)
    made.send(message("one", destination=BOB))
    assert (near.names(), far.names()) == ([], ["one"])
    with pytest.raises(NotConnected, match="gone"):
        made.send(message("lost", destination=EVE))
    assert made.traffic.sent.messages == 1


async def test_message_without_peer_is_refused() -> None:
    made = interface()
    assert not made.connected
    with pytest.raises(NotConnected, match="interface tag has no connection"):
        made.send(message("lost"))
    assert made.traffic.sent.messages == 0


async def test_message_to_several_peers_is_counted_once(links: tuple[FakeLink, FakeLink]) -> None:
    near, far = links
    made = interface(a=near, b=far)
    made.send(message("all", b"12345"))
    made.send(message("one", b"123", destination=ANN))
    assert (made.traffic.sent.messages, made.traffic.sent.bytes) == (2, 8)


async def test_drops_are_counted_for_all_peers_behind_their_link(links: tuple[FakeLink, FakeLink]) -> None:
    near, far = links
    far.drops = 3
    made = interface(a=near, b=far, e=far)
    made.send(message("all"))
    assert made.dropped == 3
    assert {peer: made.traffic.of(peer).drops for peer in (ANN, BOB, EVE)} == {ANN: 0, BOB: 3, EVE: 3}


@pytest.mark.parametrize(
    ("qos", "keep"),
    [
        (Qos(), 1000),
        (Qos("best_effort"), 10),
        (Qos(depth=3), 3),
        (Qos(history="keep_all"), None),
        (Qos(history="keep_all", depth=3), None),
    ],
)
async def test_newest_messages_wait_unless_all_are_kept(
    links: tuple[FakeLink, FakeLink], qos: Qos, keep: int | None
) -> None:
    made = interface(qos, a=links[0])
    made.send(message("1"))
    assert [kept for _, kept in links[0].sent] == [keep]


async def test_sender_waits_for_room_only_with_keep_all(links: tuple[FakeLink, FakeLink]) -> None:
    near, far = links
    far.room = asyncio.get_running_loop().create_future()
    assert interface(a=near, b=far).wait_for_room() is None
    keep_all = interface(Qos(history="keep_all"), a=near, b=far)
    assert keep_all.wait_for_room() is far.room
    far.room = None
    assert keep_all.wait_for_room() is None


async def test_service_messages_are_never_dropped_but_limited(links: tuple[FakeLink, FakeLink]) -> None:
    near, _ = links
    made = interface(Qos(depth=1), a=near)
    near.waiting = MAX_REQUESTS - 1
    made.request(message("call"))
    assert [kept for _, kept in near.sent] == [None]
    near.waiting = MAX_REQUESTS
    with pytest.raises(LimitExceeded, match="u/r/tag"):
        made.request(message("one too many"))
    assert near.names() == ["call"]


async def test_error_answers_the_requesting_peer(links: tuple[FakeLink, FakeLink]) -> None:
    near, far = links
    made = interface(a=near, b=far)
    made.fail(Message(BOB, "call", b""), TimedOut("too late"))
    ((answer, _),) = far.sent
    assert near.sent == []
    assert (answer.source, answer.destination, answer.msg_id, answer.error) == (made.id, BOB, "call", True)
    error = error_of(answer)
    assert (type(error), str(error)) == (TimedOut, "too late")


async def test_error_for_peer_that_is_gone_is_left_out(links: tuple[FakeLink, FakeLink]) -> None:
    near, far = links
    far.waiting = MAX_REQUESTS
    made = interface(a=near)
    made.fail(Message(EVE, "call", b""), TimedOut("nobody to tell"))
    interface(b=far).fail(Message(BOB, "call", b""), TimedOut("its queue is full"))
    assert (near.sent, far.sent) == ([], [])


@pytest.mark.parametrize("payload", [b"", b"\xff\x00", b"\x01", b"\x81\xa4code\xa1\xff"], ids=repr)
async def test_malformed_error_is_an_error_too(payload: bytes) -> None:
    assert "malformed" in str(error_of(message("call", payload)))


@pytest.mark.parametrize("name", ["sensor_msgs/Image", "sensor_msgs/msg/Image", "sensor_msgs/PointCloud2"])
async def test_few_of_large_messages_wait_by_default(name: str) -> None:
    def keep(qos: Qos) -> int | None:
        return Plain(InterfaceSpec(ID, "u/r", "tag", "PublisherConverter", name, qos=qos), HopRecorder()).keep

    assert (keep(Qos()), keep(Qos(depth=500)), keep(Qos(history="keep_all"))) == (10, 500, None)
