"""How links open over real sockets, by which addresses and keys, and what keeps them from it."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from pathlib import Path

import pytest
from certified import certify
from ends import KEY, A, End, Listener
from raw_robot import WAIT

from containers.data_relay import DataRelay
from endpoints import data_port as module
from endpoints.data_port import GREETING, MAGIC, DataPort, answer_to
from endpoints.frames import Message
from rce.certificates import Authority
from rce.errors import Unavailable
from rce.tls import CA, Tls


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
