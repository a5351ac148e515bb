"""Opening of links over real sockets: addresses, keys, TLS, relays and failures."""

from __future__ import annotations

import asyncio
import secrets
import time
from contextlib import suppress
from pathlib import Path

import pytest

from containers.data_relay import DataRelay
from endpoints.data import port as data_port
from endpoints.data.frames import Message
from endpoints.data.port import GREETING_SIZE, MAGIC, DataPort, key_digest
from rce.errors import Unavailable
from rce.net.certificates import Authority
from rce.net.tls import CA, Tls
from tests.support.certificates import certify
from tests.support.endpoints.ends import KEY, A, End, Listener
from tests.support.endpoints.raw_robot import WAIT


async def test_messages_sent_before_opening_are_delivered_after(port: tuple[Listener, list[str]]) -> None:
    listener, addresses = port
    here, there = End(), End()
    for number in range(5):
        here.link.send(Message(A, str(number), b""), 3)
    listener.expect(there.link, KEY)
    await listener.dial(here.link, KEY, addresses)
    await there.until(lambda: len(there.received) == 3)
    assert [m.msg_id for m in there.received] == ["2", "3", "4"]
    here.link.close()
    there.link.close()


async def test_wrong_key_is_rejected_with_reason_of_each_address(port: tuple[Listener, list[str]]) -> None:
    listener, addresses = port
    here, there = End(), End()
    listener.expect(there.link, KEY)
    await listener.dial(here.link, bytes(16), addresses)
    assert len(here.lost) == 1
    for address in addresses:
        assert address in here.lost[0]
    with pytest.raises(Unavailable, match="did not open"):
        await here.link.opened
    assert not there.link.opened.done()
    assert not there.lost
    there.link.close()


async def test_key_opens_only_one_link(pair: tuple[End, End], port: tuple[Listener, list[str]]) -> None:
    listener, addresses = port
    thief = End()
    await listener.dial(thief.link, KEY, addresses)
    assert len(thief.lost) == 1
    here, there = pair
    here.link.send(Message(A, "still", b""), None)
    await there.until(lambda: bool(there.received))


async def test_tls_rejects_certificates_of_other_authorities(tls: Tls, tmp_path: Path) -> None:
    listener, relay = Listener(tls=tls), DataRelay(tls)
    _, address = await listener.start(tmp_path)
    await relay.listen("127.0.0.1", 0)
    await relay.add_environment("ann/far", tmp_path / "data.sock", tmp_path)
    stranger = Tls(certify(tmp_path / "stranger", Authority.make("other"), ["127.0.0.1"]))
    stranger.client.load_verify_locations(tls.directory / CA)  # it trusts our certificates, but we do not trust its own
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


@pytest.mark.parametrize("way", ["data port", "relay"])
async def test_certificate_of_a_removed_machine_is_refused(tmp_path: Path, way: str) -> None:
    authority, now = Authority.make("test"), time.time()
    here = Tls(certify(tmp_path / "here", authority, ["127.0.0.1"], "here"))
    gone = Tls(certify(tmp_path / "gone", authority, ["127.0.0.1"], "gone"))
    again = Tls(certify(tmp_path / "again", authority, ["127.0.0.1"], "gone", after=now - 60))
    listener, relay = Listener(tls=here), DataRelay(here)
    _, address = await listener.start(tmp_path)
    await relay.listen("127.0.0.1", 0)
    await relay.add_environment("ann/far", tmp_path / "data.sock", tmp_path)
    dialled = address if way == "data port" else f"{relay.address}/ann/far"

    async def opened(tls: Tls) -> tuple[End, End]:
        one, other, key = End(), End(), secrets.token_bytes(16)
        listener.expect(other.link, key)
        await DataPort(tls=tls).dial(one.link, key, [dialled])
        return one, other

    open_before = await opened(gone)
    assert not open_before[0].lost
    here.set_removed({"gone": now - 60, "other": now})
    await open_before[0].until(lambda: bool(open_before[0].lost))
    one, other = await opened(gone)
    assert one.lost
    assert not other.link.opened.done()
    other.link.close()
    one, other = await opened(again)
    assert not one.lost
    for link in (one.link, other.link):
        link.close()
    await relay.close()
    await listener.close()


async def test_refusal_of_relay_has_reason(relays: tuple[str, Path]) -> None:
    relayed, gate = relays
    end = End()
    await DataPort(gate).dial(end.link, KEY, [relayed.replace("/ann/", "/bob/")])
    assert "another user's" in end.lost[0]


async def test_closed_link_accepts_no_connection(port: tuple[Listener, list[str]]) -> None:
    listener, addresses = port
    here, there = End(), End()
    listener.expect(there.link, KEY)
    there.link.close()
    await asyncio.sleep(0)
    assert not listener.expected
    await listener.dial(here.link, KEY, addresses)
    assert (len(here.lost), there.lost) == (1, [])


async def test_next_address_is_tried_and_failed_connections_are_closed(
    port: tuple[Listener, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server at the first address never answers, that at the second sends a wrong digest."""
    monkeypatch.setattr(data_port, "OPEN_TIMEOUT", 0.5)
    listener, addresses = port
    ended: list[bytes] = []
    done = asyncio.Event()

    async def mute(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionError):
            ended.append(await reader.read())
        monkeypatch.setattr(data_port, "OPEN_TIMEOUT", WAIT)  # the good address may need longer on a busy machine
        writer.close()
        done.set()

    async def impostor(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(MAGIC + bytes(16))
        await mute(reader, writer)

    async with (
        await asyncio.start_server(mute, "127.0.0.1", 0) as first,
        await asyncio.start_server(impostor, "127.0.0.1", 0) as second,
    ):
        bad = [f"tcp:127.0.0.1:{server.sockets[0].getsockname()[1]}" for server in (first, second)]
        here, there = End(), End()
        listener.expect(there.link, KEY)
        await listener.dial(here.link, KEY, [*bad, "tcp:127.0.0.1:1", "unix:/nowhere", "nonsense", *addresses])
        await asyncio.wait_for(here.link.opened, WAIT)
        await asyncio.wait_for(done.wait(), WAIT)
        here.link.send(Message(A, "through", b""), None)
        await there.until(lambda: bool(there.received))
    assert not here.lost
    here.link.close()
    there.link.close()


async def test_dialling_ends_after_the_time_for_all_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(data_port, "DIAL_TIMEOUT", 0.05)
    held: list[asyncio.StreamWriter] = []  # a writer that nobody holds closes its connection
    silent = await asyncio.start_server(lambda _, writer: held.append(writer), "127.0.0.1", 0)
    async with silent:
        address = f"tcp:127.0.0.1:{silent.sockets[0].getsockname()[1]}"
        dialling = End()
        await asyncio.wait_for(DataPort().dial(dialling.link, KEY, [address] * 100), WAIT)
        assert dialling.link.broken == "no link within 0.05 s"
        for writer in held:
            writer.close()


async def test_expected_link_fails_when_nobody_connects(
    port: tuple[Listener, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(data_port, "EXPECT_TIMEOUT", 0.01)
    monkeypatch.setattr(data_port, "OPEN_TIMEOUT", 0.01)
    listener, addresses = port
    end = End()
    listener.expect(end.link, KEY)
    reader, writer = await asyncio.open_unix_connection(addresses[0].removeprefix("unix:"))
    writer.write(MAGIC + KEY[:-1])  # an incomplete greeting
    await end.until(lambda: bool(end.lost))
    assert end.lost == ["the other side did not connect within 0.01 s"]
    assert not listener.expected
    with suppress(ConnectionError):
        assert await asyncio.wait_for(reader.read(), WAIT) == b"", "an incomplete greeting is cut off"
    writer.close()


@pytest.mark.parametrize(
    "garbage", [b"\xff" * 400, b"\x01\xff" + bytes(12) + bytes(16) + b"\xff" * 255], ids=["head", "name"]
)
async def test_garbage_breaks_link_and_is_reported_once(port: tuple[Listener, list[str]], garbage: bytes) -> None:
    listener, addresses = port
    end = End()
    listener.expect(end.link, KEY)
    reader, writer = await asyncio.open_unix_connection(addresses[0].removeprefix("unix:"))
    writer.write(MAGIC + KEY + garbage)
    with suppress(ConnectionError):
        assert (await asyncio.wait_for(reader.read(), WAIT))[:GREETING_SIZE] in (b"", MAGIC + key_digest(KEY))
    writer.close()
    await end.until(lambda: bool(end.lost))
    await asyncio.sleep(0)
    (reason,) = end.lost
    assert "exceeds" in reason or "utf-8" in reason
    end.link.close()
