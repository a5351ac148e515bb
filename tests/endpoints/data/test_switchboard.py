"""Routes between interfaces: delivery, idempotent changes, moved links, and traffic counts."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from unittest.mock import Mock

import pytest
from twisted.logger import LogEvent

from endpoints.data import switchboard
from endpoints.data.frames import Message, pieces
from endpoints.data.hops import HopRecorder
from endpoints.data.interface import Interface
from endpoints.data.link import Link, StreamLink
from endpoints.data.port import DataPort
from endpoints.data.switchboard import Switchboard
from rce.control.calls.endpoints import InterfaceSpec, LinkSpec, Route, Sync
from rce.control.calls.watching import Counts, CountTraffic, InterfaceTraffic
from rce.errors import NotConnected, NotFound, Unavailable
from rce.protocol.messages import Qos
from tests.support.endpoints.ends import End


class Recorder(Interface):
    """Interface that records its events and messages; it fails while `broken` is set."""

    def __init__(self, spec: InterfaceSpec, hops: HopRecorder) -> None:
        super().__init__(spec, hops)
        self.events: list[str] = []
        self.received: list[Message] = []
        self.broken = False

    def receive(self, message: Message, link: Link) -> None:
        if self.broken:
            raise ZeroDivisionError
        self.dropped += message.msg_id == "too much"
        self.received.append(message)

    def joined(self, peer: bytes) -> None:
        self.events.append(f"joined {peer.hex()[-1]}")

    def started(self) -> None:
        self.events.append("started")

    def stopped(self) -> None:
        self.events.append("stopped")

    def close(self) -> None:
        self.events.append("closed")


def spec(number: int, qos: Qos | None = None) -> InterfaceSpec:
    return InterfaceSpec(f"{number:032x}", "u/r", f"i{number}", "PublisherConverter", "a/B", qos=qos or Qos(depth=10))


class Board(Switchboard):
    """Switchboard of recorders, connected by a link within the process."""

    def __init__(self) -> None:
        self.lost: list[str] = []
        super().__init__(DataPort(), lambda link, reason: self.lost.append(link))

    async def make(self, spec: InterfaceSpec) -> Interface:
        return Recorder(spec, self.hops)

    async def ready(self, count: int) -> list[Recorder]:
        self.open_link(LinkSpec("l", ""))
        for number in range(count):
            await self.bind(spec(number), self.make)
        return [self.at(number) for number in range(count)]

    def at(self, number: int) -> Recorder:
        found = self.interfaces[bytes.fromhex(spec(number).id)]
        assert isinstance(found, Recorder)
        return found

    async def join(self, one: int, other: int, link: str = "l") -> None:
        for own, peer in ((one, other), (other, one)):
            await self.add_route(Route(spec(own).id, spec(peer).id, link))


async def settle() -> None:
    """Let tasks run that can."""
    for _ in range(10):
        await asyncio.sleep(0)


@pytest.fixture
async def board() -> AsyncIterator[Board]:
    made = Board()
    yield made
    for name in list(made.links):
        made.close_link(name)
    await asyncio.sleep(0)


async def test_message_goes_to_all_peers_or_to_its_destination(board: Board) -> None:
    a, b, c, stranger = await board.ready(4)
    await board.join(0, 1)
    await board.join(0, 2)
    a.send(Message(a.id, "all", b""))
    a.send(Message(a.id, "one", b"", destination=c.id))
    assert [[m.msg_id for m in each.received] for each in (a, b, c, stranger)] == [[], ["all"], ["all", "one"], []]
    with pytest.raises(NotConnected):
        a.send(Message(a.id, "", b"", destination=stranger.id))
    with pytest.raises(NotConnected):
        stranger.send(Message(stranger.id, "", b""))
    assert a.events == ["started", "joined 1", "joined 2"]


async def test_message_of_several_senders_reaches_the_peers_of_each(board: Board) -> None:
    await board.ready(5)
    for own, peer in ((0, 3), (1, 4), (2, 4)):
        await board.join(own, peer)
    senders = tuple(board.at(number).id for number in (0, 1))
    board.deliver(Message(b"s" * 16, "m", b"x", senders=senders), board.links["l"])
    assert [[each.source for each in board.at(number).received] for number in (3, 4)] == [[senders[0]], [senders[1]]]


async def test_routes_are_idempotent_and_need_link_and_interface(board: Board) -> None:
    a, b = await board.ready(2)
    for _ in range(2):
        await board.join(0, 1)
    a.send(Message(a.id, "once", b""))
    assert (len(b.received), b.events) == (1, ["started", "joined 0"])
    with pytest.raises(NotFound, match="link"):
        await board.add_route(Route(spec(0).id, spec(1).id, "other"))
    with pytest.raises(NotFound, match="interface"):
        await board.add_route(Route(spec(7).id, spec(1).id, "l"))
    with pytest.raises(NotFound, match="interface r1/pose was not added"):
        await board.add_route(Route(spec(7).id, spec(1).id, "l", "r1/pose"))
    for _ in range(2):
        board.remove_route(spec(0).id, spec(1).id)
    assert a.events[-1] == "stopped"
    b.send(Message(b.id, "to nobody", b""))
    assert not a.received


async def test_link_that_sends_a_flood_of_messages_without_a_receiver_is_dropped(board: Board) -> None:
    await board.ready(2)
    await board.join(0, 1)
    end = End("flood")
    link = end.link
    link._deliver = board.deliver
    transport = Mock(is_closing=lambda: False, get_extra_info=lambda _: None)
    link.attach(transport)
    frame = b"".join(bytes(part) for piece in pieces(Message(b"x" * 16, "", b""), 0) for part in piece)
    for _ in range(100):  # as after a connection that ended
        await feed(link, frame, transport)
    assert end.lost == []
    for _ in range(40):
        await feed(link, frame * 1000, transport)
        if end.lost:
            break
    assert end.lost == ["more than 1000 messages a second belong to no connection"]
    transport.abort.assert_called_once()


async def feed(link: StreamLink, data: bytes, transport: Mock) -> None:
    """Let a link receive bytes while it reads."""
    while data and not transport.abort.called:
        if transport.pause_reading.call_count > transport.resume_reading.call_count:
            await asyncio.sleep(0)
            continue
        buffer = link.get_buffer(0)
        count = min(len(buffer), len(data))
        buffer[:count] = data[:count]
        link.buffer_updated(count)
        data = data[count:]


async def test_unbound_interface_loses_its_peers(board: Board) -> None:
    a, b = await board.ready(2)
    await board.join(0, 1)
    for _ in range(2):
        board.unbind(spec(0).id)
    assert a.events == ["started", "joined 1", "stopped", "closed"]
    b.send(Message(b.id, "", b""))
    assert not a.received


async def test_route_moves_to_new_link_without_interruption(board: Board) -> None:
    a, b = await board.ready(2)
    await board.join(0, 1)
    until: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    old = board.links["l"]
    old.pause(until)
    for number in range(10):
        old.send(Message(a.id, str(number), b""), None)
    room = old.wait_for_room(a.id)
    assert room is not None
    board.open_link(LinkSpec("new", ""))
    await board.join(0, 1, "new")
    assert room.done()
    assert (a.events, b.events) == (["started", "joined 1"], ["started", "joined 0"])
    a.send(Message(a.id, "moved", b""))
    assert [m.msg_id for m in b.received] == ["moved"]
    until.set_result(None)


async def test_route_over_link_that_is_closed_while_opening_fails(board: Board) -> None:
    await board.ready(2)
    board.open_link(LinkSpec("slow", "00" * 16))
    route = asyncio.create_task(board.add_route(Route(spec(0).id, spec(1).id, "slow")))
    await asyncio.sleep(0)
    board.close_link("slow")
    with pytest.raises(Unavailable):
        await asyncio.wait_for(route, 60)
    assert not board.at(0).peers
    assert not board.lost, "a link closed on purpose is not lost"


async def test_sync_reconciles_interfaces_links_and_routes(board: Board) -> None:
    a, b, c = await board.ready(3)
    await board.join(0, 1)
    await board.join(0, 2)
    changed = spec(1, qos=Qos(depth=3))
    routes = [Route(one, other, "l") for one, other in ((a.spec.id, b.spec.id), (b.spec.id, a.spec.id))]
    call = Sync([a.spec, changed, spec(3)], [LinkSpec("l", "")], routes)
    for _ in range(2):
        assert await board.sync(call, board.make) == {}
        assert {each.spec for each in board.interfaces.values()} == {a.spec, changed, spec(3)}
        assert list(a.peers) == [b.id]
    assert c.events[-1] == b.events[-1] == "closed"
    assert board.at(0) is a
    a.send(Message(a.id, "hi", b""))
    assert len(board.at(1).received) == 1
    await board.sync(Sync(), board.make)
    assert not board.interfaces
    assert not board.links


async def test_sync_is_answered_before_links_open(board: Board) -> None:
    """A link of one user that never opens would block the calls about everybody's interfaces."""
    routes = [Route(spec(0).id, spec(1).id, "l"), Route(spec(0).id, spec(2).id, "slow")]
    call = Sync([spec(0), spec(1)], [LinkSpec("l", ""), LinkSpec("slow", "00" * 16)], routes)
    assert await asyncio.wait_for(board.sync(call, board.make), 60) == {}
    assert [peer.hex() for peer in board.at(0).peers] == [spec(1).id]
    board.links["slow"].opened.set_result(None)
    await settle()
    assert len(board.at(0).peers) == 2


async def test_route_that_is_removed_while_its_link_opens_is_not_added(board: Board) -> None:
    route = Route(spec(0).id, spec(1).id, "slow")
    call = Sync([spec(0)], [LinkSpec("slow", "00" * 16)], [route])
    for end in (lambda: board.remove_route(route.interface, route.peer), lambda: board.unbind(spec(0).id)):
        await board.sync(call, board.make)
        end()
        if not board.links["slow"].opened.done():
            board.links["slow"].opened.set_result(None)
        await settle()
        assert not any(each.peers for each in board.interfaces.values())


async def test_sync_does_not_wait_for_a_slow_interface(board: Board, monkeypatch: pytest.MonkeyPatch) -> None:
    """The definition of its type may come from an environment that does not answer."""
    monkeypatch.setattr(switchboard, "SYNC_PATIENCE", 0.01)
    answered = asyncio.Event()

    async def make(spec: InterfaceSpec) -> Interface:
        if spec.tag == "i0":
            await answered.wait()
        return await board.make(spec)

    failed = await board.sync(Sync([spec(0), spec(1)]), make)
    assert list(failed) == [spec(0).id]
    assert "still waits for the definition of a/B" in failed[spec(0).id].message
    assert board.at(1)
    answered.set()
    await settle()
    assert len(board.interfaces) == 2


async def test_slow_interface_that_is_removed_meanwhile_is_not_created(
    board: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(switchboard, "SYNC_PATIENCE", 0.0)
    answered = asyncio.Event()

    async def make(spec: InterfaceSpec) -> Interface:
        await answered.wait()
        return await board.make(spec)

    await board.sync(Sync([spec(0), spec(1)]), make)
    board.unbind(spec(0).id)
    assert list(await board.sync(Sync([spec(2)]), make)) == [spec(2).id]
    answered.set()
    await settle()
    assert [each.spec for each in board.interfaces.values()] == [spec(2)]


async def test_defective_interface_does_not_affect_others(board: Board, failures: list[LogEvent]) -> None:
    a, b, c = await board.ready(3)
    await board.join(0, 1)
    await board.join(0, 2)
    b.broken = True
    a.send(Message(a.id, "hi", b""))
    assert len(c.received) == 1
    assert len(failures) == 1
    failures.clear()


async def test_traffic_is_counted_for_each_peer(board: Board) -> None:
    a, b, c = await board.ready(3)
    await board.join(0, 1)
    await board.join(0, 2)
    a.send(Message(a.id, "to all", b"12345"))
    a.send(Message(a.id, "too much", b"1", destination=b.id))
    b.send(Message(b.id, "answer", b"123"))
    seen = (await board.traffic(CountTraffic())).interfaces
    assert seen[a.spec.id] == InterfaceTraffic(
        Counts(2, 6), Counts(1, 3), {b.spec.id: Counts(1, 3), c.spec.id: Counts()}
    )
    assert seen[b.spec.id] == InterfaceTraffic(Counts(1, 3, 1), Counts(2, 6), {a.spec.id: Counts(2, 6, 1)})
    board.remove_route(a.spec.id, b.spec.id)
    gone = (await board.traffic(CountTraffic())).interfaces[a.spec.id]
    assert (gone.received, list(gone.peers)) == (Counts(1, 3), [c.spec.id]), "received messages stay counted"


async def test_drops_are_counted_for_peers_behind_their_link(board: Board) -> None:
    a, b, c = await board.ready(3)
    await board.join(0, 1)
    board.open_link(LinkSpec("other", ""))
    await board.join(0, 2, "other")
    until: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    board.links["l"].pause(until)
    for _ in range(15):  # 10 of them may wait
        a.send(Message(a.id, "", b""))
    seen = (await board.traffic(CountTraffic())).interfaces
    assert seen[a.spec.id].sent == Counts(15, 0, 5)
    assert {peer: counts.drops for peer, counts in seen[a.spec.id].peers.items()} == {b.spec.id: 5, c.spec.id: 0}
    assert (seen[b.spec.id].received.messages, seen[c.spec.id].received.messages) == (0, 15)
    until.set_result(None)
