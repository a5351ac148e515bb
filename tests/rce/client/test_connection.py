"""Frames of one connection: malformed frames of the server, and the order of outgoing frames."""

from __future__ import annotations

import pytest
from websockets.asyncio.server import Request, Response, ServerConnection, serve

from rce.client import Disconnected, Reconnected, connection
from rce.client.address import Address
from rce.errors import InvalidRequest, Unavailable
from tests.support.client_contract import STRING, WAIT, until
from tests.support.fake_platform import FakePlatform


@pytest.mark.parametrize(
    "payload",
    [
        "{",
        '{"type":"XX","data":{}}',
        '{"type":"DM","data":{}}',
        '{"type":"ST","data":{"topic":"iu"}}',
        "zz",
        b"\xff\xfe",
    ],
)
async def test_malformed_frame_is_an_event_and_does_not_end_the_connection(
    fake: FakePlatform, payload: str | bytes
) -> None:
    async with fake.robot() as a:
        events = a.events()
        await fake.send_raw("a", payload)
        assert isinstance(await events.get(10), InvalidRequest)
        await a.create_environment("brain")


async def test_server_that_grants_features_and_sends_nothing_is_unavailable(monkeypatch: pytest.MonkeyPatch) -> None:
    def grant(socket: ServerConnection, request: Request, response: Response) -> None:
        response.headers["RCE-Features"] = "ack"

    monkeypatch.setattr(connection, "SESSION_TIMEOUT", 0.01)
    async with serve(lambda socket: socket.wait_closed(), "127.0.0.1", 0, process_response=grant) as server:
        endpoint = f"ws://127.0.0.1:{next(iter(server.sockets)).getsockname()[1]}/"
        with pytest.raises(Unavailable, match="sent no session status: no answer"):
            await connection.Connection.open(Address("http://127.0.0.1:1/", "u", "a", "p"), endpoint, "")


async def test_small_frames_overtake_the_parts_of_a_large_blob(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        images = await a.publisher("images", STRING, raw=True)
        await a.subscriber("in1", STRING, to="a/images", raw=True)
        publisher = await a.publisher("out", STRING)
        await a.subscriber("in2", STRING, to="a/out")
        fake.frame_types.clear()
        await images.publish(bytes(8 * 256 * 1024))
        await publisher.publish({"data": "stop"})
        await a.set_parameter("brain", "x", 1)
        await until(lambda: fake.frame_types.count("part") == 8)
        assert fake.frame_types.index("CN") < 5
        assert sorted(fake.frame_types) == ["CN", "DM", "DM", *["part"] * 8]


async def test_session_is_resumed_when_the_address_of_the_line_is_gone(
    fake: FakePlatform, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = iter([True])
    monkeypatch.setattr(connection, "address_is_gone", lambda _: next(gone, False))
    async with fake.robot("a") as a:
        events = a.events()
        subscriber = await a.subscriber("in", STRING)
        publisher = await a.publisher("out", STRING, to="a/in")
        assert isinstance(await events.get(WAIT), Disconnected)
        assert await events.get(WAIT) == Reconnected(resumed=True)
        await publisher.publish({"data": "again"})
        assert await subscriber.get(WAIT) == {"data": "again"}
