"""Routes between interfaces: who gets what, in which order things may be asked for, and what a moved link leaves."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest
from twisted.logger import LogEvent

from endpoints.data_port import DataPort
from endpoints.frames import Message
from endpoints.hops import Watch
from endpoints.interface import Interface, error_of
from endpoints.link import Link
from endpoints.switchboard import Switchboard
from rce.calls.endpoints import InterfaceSpec, LinkSpec, Route, Sync
from rce.calls.watching import Counts, CountTraffic, InterfaceTraffic
from rce.errors import NotConnected, NotFound, TimedOut, Unavailable
from rce.messages import Qos


class Recorder(Interface):
    """Writes down what happens to it; `broken` makes it a defective one."""

    def __init__(self, spec: InterfaceSpec, watch: Watch) -> None:
        super().__init__(spec, watch)
        self.events: list[str] = []
        self.got: list[Message] = []
        self.broken = False

    def receive(self, message: Message, link: Link) -> None:
        if self.broken:
            raise ZeroDivisionError
        self.dropped += message.msg_id == "too much"
        self.got.append(message)

    def joined(self, peer: bytes) -> None:
        self.events.append(f"joined {peer.hex()[-1]}")

    def started(self) -> None:
        self.events.append("started")

    def stopped(self) -> None:
        self.events.append("stopped")

    def close(self) -> None:
        self.events.append("closed")


def spec(number: int, **more: object) -> InterfaceSpec:
    return InterfaceSpec(f"{number:032x}", "u/r", f"i{number}", "PublisherConverter", "a/B", **more)  # type: ignore[arg-type]


class Board(Switchboard):
    """With `count` interfaces bound and a link within the process."""

    def __init__(self) -> None:
        self.lost: list[str] = []
        super().__init__(DataPort(), lambda link, reason: self.lost.append(link))

    async def make(self, spec: InterfaceSpec) -> Interface:
        return Recorder(spec, self.watch)

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


@pytest.fixture
async def board() -> AsyncIterator[Board]:
    made = Board()
    yield made
    for name in list(made.links):
        made.close_link(name)
    await asyncio.sleep(0)


async def test_a_message_goes_to_every_peer_or_to_the_one_it_names(board: Board) -> None:
    a, b, c, stranger = await board.ready(4)
    await board.join(0, 1)
    await board.join(0, 2)
    a.send(Message(a.id, "all", b""))
    a.send(Message(a.id, "one", b"", destination=c.id))
    assert [[m.msg_id for m in each.got] for each in (a, b, c, stranger)] == [[], ["all"], ["all", "one"], []]
    with pytest.raises(NotConnected):
        a.send(Message(a.id, "", b"", destination=stranger.id))
    with pytest.raises(NotConnected):
        stranger.send(Message(stranger.id, "", b""))
    assert a.events == ["started", "joined 1", "joined 2"]


async def test_routes_may_be_asked_for_twice_and_need_their_link_and_interface(board: Board) -> None:
    a, b = await board.ready(2)
    for _ in range(2):
        await board.join(0, 1)
    a.send(Message(a.id, "once", b""))
    assert (len(b.got), b.events) == (1, ["started", "joined 0"])
    with pytest.raises(NotFound, match="link"):
        await board.add_route(Route(spec(0).id, spec(1).id, "other"))
    with pytest.raises(NotFound, match="interface"):
        await board.add_route(Route(spec(7).id, spec(1).id, "l"))
    for _ in range(2):
        board.remove_route(spec(0).id, spec(1).id)
    assert a.events[-1] == "stopped"
    b.send(Message(b.id, "to nobody", b""))
    assert not a.got


async def test_unbinding_parts_it_from_its_peers(board: Board) -> None:
    a, b = await board.ready(2)
    await board.join(0, 1)
    for _ in range(2):
        board.unbind(spec(0).id)
    assert a.events == ["started", "joined 1", "stopped", "closed"]
    b.send(Message(b.id, "", b""))
    assert not a.got


async def test_a_route_moves_to_a_new_link_without_a_stop_and_lets_waiters_go(board: Board) -> None:
    a, b = await board.ready(2)
    await board.join(0, 1)
    until: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    old = board.links["l"]
    old.pause(until)
    for number in range(10):
        old.send(Message(a.id, str(number), b""), None)
    room = old.room(a.id)
    assert room is not None
    board.open_link(LinkSpec("new", ""))
    await board.join(0, 1, "new")
    assert room.done()
    assert (a.events, b.events) == (["started", "joined 1"], ["started", "joined 0"])
    a.send(Message(a.id, "moved", b""))
    assert [m.msg_id for m in b.got] == ["moved"]
    until.set_result(None)


async def test_a_route_that_waits_for_a_link_that_is_closed_is_refused(board: Board) -> None:
    await board.ready(2)
    board.open_link(LinkSpec("slow", "00" * 16))
    route = asyncio.create_task(board.add_route(Route(spec(0).id, spec(1).id, "slow")))
    await asyncio.sleep(0)
    board.close_link("slow")
    with pytest.raises(Unavailable):
        await asyncio.wait_for(route, 10)
    assert not board.at(0).peers
    assert not board.lost, "it was closed on purpose"


async def test_sync_makes_what_lacks_and_removes_what_is_too_much(board: Board) -> None:
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
    assert len(board.at(1).got) == 1
    await board.sync(Sync(), board.make)
    assert not board.interfaces
    assert not board.links


async def test_one_defective_interface_costs_the_others_nothing(board: Board, failures: list[LogEvent]) -> None:
    a, b, c = await board.ready(3)
    await board.join(0, 1)
    await board.join(0, 2)
    b.broken = True
    a.send(Message(a.id, "hi", b""))
    assert len(c.got) == 1
    assert len(failures) == 1
    failures.clear()


async def test_a_failure_is_carried_to_who_asked(board: Board) -> None:
    a, b = await board.ready(2)
    await board.join(0, 1)
    a.request(Message(a.id, "call", b""))
    b.fail(b.got[0], TimedOut("too late"))
    (answer,) = a.got
    assert (answer.msg_id, answer.error, error_of(answer).info.code) == ("call", True, "timed_out")
    assert error_of(Message(a.id, "", b"\xff\x00", error=True)).info.code == "error"
    board.remove_route(spec(1).id, spec(0).id)
    b.fail(b.got[0], TimedOut("nobody to tell"))


async def test_what_passes_is_counted_of_each_peer(board: Board) -> None:
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
    assert (gone.received, list(gone.peers)) == (Counts(1, 3), [c.spec.id]), "what came stays counted"


async def test_drops_on_a_link_count_for_the_peers_behind_it(board: Board) -> None:
    a, b, c = await board.ready(3)
    await board.join(0, 1)
    board.open_link(LinkSpec("other", ""))
    await board.join(0, 2, "other")
    until: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    board.links["l"].pause(until)
    for _ in range(15):  # of which 10 may wait
        a.send(Message(a.id, "", b""))
    seen = (await board.traffic(CountTraffic())).interfaces
    assert seen[a.spec.id].sent == Counts(15, 0, 5)
    assert {peer: counts.drops for peer, counts in seen[a.spec.id].peers.items()} == {b.spec.id: 5, c.spec.id: 0}
    assert (seen[b.spec.id].received.messages, seen[c.spec.id].received.messages) == (0, 15)
    until.set_result(None)
