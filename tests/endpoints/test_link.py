"""Links over real sockets: how they open, what they carry, how they end."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from pathlib import Path

import pytest
from certified import certify
from raw_robot import WAIT

from containers.data_relay import GATE, DataRelay
from endpoints import data_port as module
from endpoints.data_port import GREETING, MAGIC, DataPort, answer_to
from endpoints.frames import Message
from endpoints.link import Link, LoopLink, StreamLink
from endpoints.throttle import BURST, LEAST, Throttle
from rce.certificates import Authority
from rce.errors import Unavailable
from rce.tls import CA, Tls

KEY = bytes(range(16))
A, B = bytes(16), b"b" * 16


class End:
    """A link with what came out of it and how it ended."""

    def __init__(self, name: str = "l", throttle: Throttle | None = None) -> None:
        self.got: list[Message] = []
        self.lost: list[str] = []
        self.left: list[Message] = []
        self.news = asyncio.Event()
        self.link = StreamLink(name, self._deliver, self._lost, self.left.append, throttle)

    def _deliver(self, message: Message, link: Link) -> None:
        self.got.append(message)
        self.news.set()

    def _lost(self, link: StreamLink, reason: str) -> None:
        self.lost.append(reason)
        self.news.set()

    async def until(self, wanted: Callable[[], bool]) -> None:
        async with asyncio.timeout(WAIT):
            while not wanted():
                self.news.clear()
                await self.news.wait()


class Listener(DataPort):
    """A port with an address of each kind."""

    async def start(self, directory: Path) -> list[str]:
        path = directory / "data.sock"
        await self.listen_unix(path)
        return [f"unix:{path}", f"tcp:127.0.0.1:{await self.listen_tcp('127.0.0.1', 0)}"]


@pytest.fixture
def security(request: pytest.FixtureRequest) -> Tls | None:
    """TLS, if the way of this test has it."""
    found: Tls | None = None
    if "way" in request.fixturenames and request.getfixturevalue("way").endswith("tls"):
        found = request.getfixturevalue("tls")
    return found


@pytest.fixture
async def port(tmp_path: Path, security: Tls | None) -> AsyncIterator[tuple[Listener, list[str]]]:
    made = Listener(tls=security)
    yield made, await made.start(tmp_path)
    await made.close()


@pytest.fixture
async def relays(
    port: tuple[Listener, list[str]], tmp_path: Path, security: Tls | None
) -> AsyncIterator[tuple[str, Path]]:
    """The port as an environment's on another machine: its address there, and the gate of one on this machine."""
    far, near = DataRelay(security), DataRelay(security)
    await far.listen("127.0.0.1", 0)
    for name, relay in (("far", far), ("near", near)):
        (tmp_path / name).mkdir()
        await relay.admit(f"ann/{name}", tmp_path / "data.sock", tmp_path / name)
    near.know([far.address.removeprefix("relay:")])
    yield f"{far.address}/ann/far", tmp_path / "near" / GATE
    await near.close()
    await far.close()


@pytest.fixture(scope="session")
def tls(tmp_path_factory: pytest.TempPathFactory) -> Tls:
    return Tls(certify(tmp_path_factory.mktemp("tls") / "own", Authority.make("test"), ["127.0.0.1"]))


@pytest.fixture(params=["unix", "tcp", "relay", "gate", "tcp with tls", "relay with tls", "gate with tls"])
def way(request: pytest.FixtureRequest) -> str:
    """By which a link goes."""
    chosen: str = request.param
    return chosen


@pytest.fixture
async def pair(
    way: str, port: tuple[Listener, list[str]], relays: tuple[str, Path], security: Tls | None
) -> AsyncIterator[tuple[End, End]]:
    listener, addresses = port
    relayed, gate = relays
    here, there = End("here"), End("there")
    listener.expect(there.link, KEY)
    dialler = DataPort(gate) if way.startswith("gate") else DataPort(tls=security)
    kind = "relay" if way.startswith("gate") else way.partition(" ")[0]
    await dialler.dial(here.link, KEY, [each for each in (*addresses, relayed) if each.startswith(kind)])
    await asyncio.wait_for(asyncio.gather(here.link.opened, there.link.opened), WAIT)
    yield here, there
    here.link.close()
    there.link.close()
    await asyncio.sleep(0)


async def test_messages_go_both_ways_whole_and_in_order(pair: tuple[End, End]) -> None:
    here, there = pair
    for end, other in ((here, there), (there, here)):
        for number in range(100):
            end.link.send(Message(A, str(number), b"x" * number), None)
        end.link.send(Message(B, "large", b"y" * 3_000_000), None)
        await other.until(lambda other=other: len(other.got) == 101)  # type: ignore[misc]
        assert sorted(message.msg_id for message in end.left) == sorted(message.msg_id for message in other.got)
        assert [m.msg_id for m in other.got if m.source == A] == [str(number) for number in range(100)]
        assert bytes(next(m for m in other.got if m.source == B).payload) == b"y" * 3_000_000


async def test_what_is_sent_before_it_opens_leaves_then(port: tuple[Listener, list[str]]) -> None:
    listener, addresses = port
    here, there = End(), End()
    for number in range(5):
        here.link.send(Message(A, str(number), b""), 3)
    listener.expect(there.link, KEY)
    await listener.dial(here.link, KEY, addresses)
    await there.until(lambda: len(there.got) == 3)
    assert [m.msg_id for m in there.got] == ["2", "3", "4"]
    here.link.close()
    there.link.close()


async def test_a_wrong_key_opens_nothing_and_is_said_once(port: tuple[Listener, list[str]]) -> None:
    listener, addresses = port
    here, there = End(), End()
    listener.expect(there.link, KEY)
    await listener.dial(here.link, bytes(16), addresses)
    assert len(here.lost) == 1
    for address in addresses:
        assert address in here.lost[0], "the reason of each address"
    with pytest.raises(Unavailable, match="did not open"):
        await here.link.opened
    assert not there.link.opened.done()
    assert not there.lost
    there.link.close()


async def test_a_key_is_good_for_one_opening(pair: tuple[End, End], port: tuple[Listener, list[str]]) -> None:
    listener, addresses = port
    thief = End()
    await listener.dial(thief.link, KEY, addresses)
    assert len(thief.lost) == 1
    here, there = pair
    here.link.send(Message(A, "still", b""), None)
    await there.until(lambda: bool(there.got))


async def test_tls_lets_nobody_in_who_is_not_of_the_platform(tls: Tls, tmp_path: Path) -> None:
    listener, relay = Listener(tls=tls), DataRelay(tls)
    _, address = await listener.start(tmp_path)
    await relay.listen("127.0.0.1", 0)
    await relay.admit("ann/far", tmp_path / "data.sock", tmp_path)
    stranger = Tls(certify(tmp_path / "stranger", Authority.make("other"), ["127.0.0.1"]))
    stranger.client.load_verify_locations(tls.directory / CA)  # it believes us, but we do not believe it
    for dialler in (DataPort(tls=stranger), DataPort()):
        for each in (address, f"{relay.address}/ann/far"):
            here, there = End(), End()
            listener.expect(there.link, KEY)
            await dialler.dial(here.link, KEY, [each])
            assert here.lost
            assert not there.link.opened.done()
            there.link.close()
    await relay.close()
    await listener.close()


async def test_a_relay_that_refuses_says_why(relays: tuple[str, Path]) -> None:
    relayed, gate = relays
    end = End()
    await DataPort(gate).dial(end.link, KEY, [relayed.replace("/ann/", "/bob/")])
    assert "another user's" in end.lost[0]


async def test_a_closed_link_takes_nobody_in(port: tuple[Listener, list[str]]) -> None:
    listener, addresses = port
    here, there = End(), End()
    listener.expect(there.link, KEY)
    there.link.close()
    await asyncio.sleep(0)
    assert not listener.expected
    await listener.dial(here.link, KEY, addresses)
    assert (len(here.lost), there.lost) == (1, [])


async def test_the_next_address_is_tried_and_nothing_is_left_of_the_first(
    port: tuple[Listener, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first address accepts and then says nothing, the second is somebody who makes its answer up."""
    monkeypatch.setattr(module, "OPEN_TIMEOUT", 0.05)
    listener, addresses = port
    ended: list[bytes] = []
    done = asyncio.Event()

    async def mute(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionError):
            ended.append(await reader.read())
        writer.close()
        done.set()

    async def liar(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(MAGIC + bytes(16))
        await mute(reader, writer)

    async with (
        await asyncio.start_server(mute, "127.0.0.1", 0) as first,
        await asyncio.start_server(liar, "127.0.0.1", 0) as second,
    ):
        bad = [f"tcp:127.0.0.1:{server.sockets[0].getsockname()[1]}" for server in (first, second)]
        here, there = End(), End()
        listener.expect(there.link, KEY)
        await listener.dial(here.link, KEY, [*bad, "tcp:127.0.0.1:1", "unix:/nowhere", "nonsense", *addresses])
        await asyncio.wait_for(here.link.opened, WAIT)
        await asyncio.wait_for(done.wait(), WAIT)
        here.link.send(Message(A, "through", b""), None)
        await there.until(lambda: bool(there.got))
    assert not here.lost
    here.link.close()
    there.link.close()


async def test_a_link_that_nobody_opens_fails(
    port: tuple[Listener, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "EXPECT_TIMEOUT", 0.01)
    monkeypatch.setattr(module, "OPEN_TIMEOUT", 0.01)
    listener, addresses = port
    end = End()
    listener.expect(end.link, KEY)
    reader, writer = await asyncio.open_unix_connection(addresses[0].removeprefix("unix:"))
    writer.write(MAGIC + KEY[:-1])  # and no further
    await end.until(lambda: bool(end.lost))
    assert end.lost == ["nobody has come to open it"]
    assert not listener.expected
    with suppress(ConnectionError):
        assert await asyncio.wait_for(reader.read(), WAIT) == b"", "who does not finish its greeting is sent away"
    writer.close()


@pytest.mark.parametrize(
    "garbage", [b"\xff" * 400, b"\x01\xff" + bytes(12) + bytes(16) + b"\xff" * 255], ids=["head", "name"]
)
async def test_garbage_ends_the_link_with_its_reason_said_once(
    port: tuple[Listener, list[str]], garbage: bytes
) -> None:
    listener, addresses = port
    end = End()
    listener.expect(end.link, KEY)
    reader, writer = await asyncio.open_unix_connection(addresses[0].removeprefix("unix:"))
    writer.write(MAGIC + KEY + garbage)
    with suppress(ConnectionError):
        assert (await asyncio.wait_for(reader.read(), WAIT))[:GREETING] in (b"", MAGIC + answer_to(KEY))
    writer.close()
    await end.until(lambda: bool(end.lost))
    await asyncio.sleep(0)
    (reason,) = end.lost
    assert "exceeds" in reason or "utf-8" in reason
    end.link.close()


async def test_an_end_that_breaks_is_reported_once_and_one_that_is_closed_never(pair: tuple[End, End]) -> None:
    here, there = pair
    here.link.close()
    await there.until(lambda: bool(there.lost))
    there.link.fail("again")
    there.link.close()
    await asyncio.sleep(0)
    assert (here.lost, len(there.lost)) == ([], 1)


async def test_who_waits_for_room_on_a_link_that_broke_is_let_go_when_it_is_closed(pair: tuple[End, End]) -> None:
    here, there = pair
    there.link.close()
    await here.until(lambda: bool(here.lost))
    for number in range(20):
        here.link.send(Message(A, str(number), b""), None)
    room = here.link.room(A)
    assert room is not None
    here.link.close()
    assert room.done()
    gc.collect()


async def test_a_paused_end_takes_nothing_until_then_and_then_all(pair: tuple[End, End]) -> None:
    here, there = pair
    until: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    there.link.pause(until)
    for number in range(60):
        here.link.send(Message(A, str(number), bytes(1_000_000)), None)
    room = here.link.room(A)
    assert room is not None, "the sender is asked to wait"
    assert not there.got
    until.set_result(None)
    await asyncio.wait_for(room, WAIT)
    await there.until(lambda: len(there.got) == 60)
    assert [m.msg_id for m in there.got] == [str(number) for number in range(60)]


async def test_what_comes_in_is_taken_at_the_rate_of_its_sender(port: tuple[Listener, list[str]]) -> None:
    """Over two links together, and all of it arrives."""
    listener, addresses = port
    rate, size = 4_000_000, 1_000_000
    throttle = Throttle(rate)
    ends = []
    for number in range(2):
        key = bytes([number]) * 16
        here, there = End(), End(throttle=throttle)
        listener.expect(there.link, key)
        await listener.dial(here.link, key, addresses)
        ends.append((here, there))
    began = asyncio.get_running_loop().time()
    for here, _ in ends:
        here.link.send(Message(A, "1", bytes(size)), None)
    for _, there in ends:
        await there.until(lambda there=there: len(there.got) == 1)  # type: ignore[misc]
    assert asyncio.get_running_loop().time() - began > (2 * size / rate - BURST) * 0.9 - 0.1
    for here, there in ends:
        here.link.close()
        there.link.close()


async def test_a_pause_outlasts_the_wait_for_the_rate(port: tuple[Listener, list[str]]) -> None:
    listener, addresses = port
    here, there = End(), End(throttle=Throttle(1_000_000))
    listener.expect(there.link, KEY)
    await listener.dial(here.link, KEY, addresses)
    here.link.send(Message(A, "1", bytes(200_000)), None)
    await there.until(lambda: len(there.got) == 1)  # and now it waits, having taken more than a tenth of a second's
    until: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    there.link.pause(until)
    await asyncio.sleep(0.3)
    here.link.send(Message(A, "2", b""), None)
    await asyncio.sleep(0.05)
    assert len(there.got) == 1
    until.set_result(None)
    await there.until(lambda: len(there.got) == 2)
    here.link.close()
    there.link.close()


def test_a_throttle() -> None:
    now = 0.0
    throttle = Throttle(1_000_000, lambda: now)
    assert throttle.take(100_000) == 0  # a tenth of a second's worth goes at once
    assert throttle.take(500_000) == 0.5
    now = 0.5
    assert throttle.take(0) == 0
    now = 100
    assert throttle.take(100_000) == 0
    assert throttle.take(1_000) == pytest.approx(0.001)
    assert Throttle(1, lambda: now).take(LEAST) == 0


async def test_a_flood_does_not_starve_the_loop(pair: tuple[End, End]) -> None:
    """While one side sends as fast as it can, others on the loop get their turns."""
    here, there = pair
    turns = 0

    async def other() -> None:
        nonlocal turns
        while True:
            await asyncio.sleep(0)
            turns += 1

    task = asyncio.create_task(other())
    for number in range(100):
        here.link.send(Message(A, str(number), bytes(1_000_000)), None)
    await there.until(lambda: len(there.got) == 100)
    task.cancel()
    assert turns > 10


async def test_a_loop_link_queues_while_it_is_paused() -> None:
    got: list[str] = []
    link = LoopLink("l", lambda message, link: got.append(message.msg_id), lambda message: None)
    assert link.opened.done()
    link.send(Message(A, "first", b""), 2)
    until: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    link.pause(until)
    dropped = [link.send(Message(A, str(number), b""), 2) for number in range(4)]
    assert (got, dropped, link.backlog(A)) == (["first"], [0, 0, 1, 1], 2)
    for number in range(10):
        link.send(Message(B, str(number), b""), None)
    room = link.room(B)
    assert room is not None
    until.set_result(None)
    await asyncio.wait_for(room, WAIT)
    assert sorted(got[1:]) == sorted(["2", "3", *map(str, range(10))])
