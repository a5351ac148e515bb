"""Who is let in at the WebSocket, and with which HTTP status the others are sent away (the original's table)."""

from __future__ import annotations

import asyncio
import hashlib
from contextlib import suppress

import pytest
from platforms import Platform
from raw_robot import PASSWORD, USER, WAIT
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from master.throttle import Throttle

WS = (
    "Host: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
)
GOOD = f"userID={USER}&robotID=r&password={PASSWORD}"
GOOD_GUEST = GOOD.replace("robotID=r", "robotID=%40r")
ADMIN = f"userID=admin&password={hashlib.sha256(b'admin').hexdigest()}"


async def knock(port: int, query: str, *headers: str) -> tuple[int, str]:
    """Status and reason of a handshake with this query."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    lines = "".join(f"{header}\r\n" for header in headers)
    writer.write(f"GET /?{query} HTTP/1.1\r\n{WS}{lines}\r\n".encode())
    answer = await asyncio.wait_for(reader.readline(), WAIT)
    writer.close()
    _, status, reason = answer.decode().split(" ", 2)
    return int(status), reason.strip()


TABLE = [
    (f"robotID=r&password={PASSWORD}", 400, "userID"),
    (f"userID={USER}&password={PASSWORD}", 400, "robotID"),
    (f"userID={USER}&robotID=r", 400, "password"),
    (f"{GOOD}&userID={USER}", 400, "userID"),
    (f"{GOOD}&robotID=r", 400, "robotID"),
    (f"{GOOD}&password=x", 400, "password"),
    (f"{GOOD}&key=x", 400, "password"),
    (f"{GOOD}&resume=a&resume=b", 400, "resume"),
    (f"{GOOD}&compress=zip", 400, "compress"),
    (f"{GOOD}&features=ack&features=ack", 400, "features"),
    (f"userID={USER}&robotID=r&password={'0' * 64}", 401, ""),
    (f"userID={USER}&robotID=r&password=", 400, "password"),
    (f"userID=nobody&robotID=r&password={PASSWORD}", 401, ""),
    (f"userID=&robotID=r&password={PASSWORD}", 400, "userID"),
    (f"userID={USER}&robotID=1r&password={PASSWORD}", 400, "robotID"),
    (f"userID={USER}&robotID=r%C3%B6&password={PASSWORD}", 400, "robotID"),
    (f"userID={USER}&robotID=%FF&password={PASSWORD}", 400, "robotID"),
    (f"userID={USER}&robotID=r%0D%0AX-Evil%3A%201&password={PASSWORD}", 400, "robotID"),
    (f"userID={USER}&robotID={'r' * 5000}&password={PASSWORD}", 400, "robotID"),
    (f"{ADMIN}&robotID=r", 400, "administrator"),
    (f"{ADMIN}&robotID=r&owner={USER}", 400, "owner"),
    (f"{ADMIN}&robotID=%40&owner={USER}", 400, "robotID"),
    (f"{ADMIN}&robotID=%40r.x&owner={USER}", 400, "robotID"),
    (f"{ADMIN}&robotID=%40r&owner={USER}&owner=x", 400, "owner"),
    (f"{ADMIN}&robotID=%40r&owner=nobody", 400, "no user nobody"),
    (f"{ADMIN}&robotID=%40r&owner=nobody&features=ack", 404, "no user nobody"),
    (f"{GOOD_GUEST}&owner=admin&features=ack", 404, "no user admin"),
    (f"{GOOD_GUEST}&owner={USER}", 101, ""),
    (f"{ADMIN}&robotID=%40s&owner={USER}", 101, ""),
    (f"{ADMIN}&robotID=%40s", 101, ""),
    (GOOD, 101, ""),
    (GOOD.replace("password", "key"), 101, ""),
    (GOOD + "&features=ack,unknown&more=1", 101, ""),
]


async def test_the_table(platform: Platform) -> None:
    for query, status, names in TABLE:
        got, reason = await knock(platform.port, query)
        assert (got, names in reason) == (status, True), f"{query}: {got} {reason}"
        assert PASSWORD not in reason
        await platform.forget("r")


async def test_a_script_hears_by_the_close_code_why_it_is_refused(platform: Platform) -> None:
    for query, status, words in TABLE:
        if status != 101:
            async with connect(f"ws://127.0.0.1:{platform.port}/?{query}&refuse=close") as socket:
                with pytest.raises(ConnectionClosed):
                    await asyncio.wait_for(socket.recv(), WAIT)
            assert socket.close_code == 4000 + status, query
            assert words in (socket.close_reason or "")


async def test_a_credential_in_the_header(platform: Platform) -> None:
    assert await knock(platform.port, f"userID={USER}&robotID=a", f"Authorization: Bearer {PASSWORD}") == (
        101,
        "Switching Protocols",
    )
    assert (await knock(platform.port, f"userID={USER}&robotID=b", "Authorization: Bearer x"))[0] == 401


@pytest.mark.parametrize("origin", ["null", "https://example.com", "file://"])
async def test_pages_from_anywhere(platform: Platform, origin: str) -> None:
    """From files too, whose origin is `null`: none has a credential that it was not given."""
    assert (await knock(platform.port, GOOD, f"Origin: {origin}"))[0] == 101


async def test_an_api_key(platform: Platform) -> None:
    secret, _ = await platform.master.users.keys.add(USER)
    assert (await knock(platform.port, f"userID={USER}&robotID=a&key={secret}"))[0] == 101
    assert (await knock(platform.port, f"userID=admin&robotID=a&key={secret}"))[0] == 401
    assert (await knock(platform.port, f"userID=&robotID=b&key={secret}"))[0] == 400  # a robot has its user's name


async def test_a_robot_id_in_use(platform: Platform) -> None:
    await platform.robot("r")
    status, reason = await knock(platform.port, GOOD)
    assert (status, "in use" in reason) == (400, True)
    assert (await knock(platform.port, GOOD + "&resume=" + "0" * 64))[0] == 400


async def test_a_request_without_end_is_cut_off(platform: Platform) -> None:
    """What is not yet logged in must not take memory."""
    _, writer = await asyncio.open_connection("127.0.0.1", platform.port)
    sent = 0
    with suppress(ConnectionError):
        while sent < 30_000_000:
            writer.write(b"GET /?x=" if not sent else b"x" * 65536)
            sent += 65536
            await writer.drain()
            await asyncio.sleep(0)
    assert sent < 30_000_000
    writer.close()


async def test_guessing_is_slowed_down_and_says_how_long(platform: Platform) -> None:
    platform.master.users.throttle = Throttle(lambda: 0.0)
    secret, _ = await platform.master.users.keys.add(USER)
    for user in (USER, "nobody"):
        wrong = f"userID={user}&robotID=r&password={'0' * 64}"
        said = [await knock(platform.port, wrong) for _ in range(6)]
        assert [status for status, _ in said] == [401] * 5 + [429]
        assert "try again in 1 s" in said[-1][1]
    assert (await knock(platform.port, GOOD))[0] == 429
    assert (await knock(platform.port, f"userID={USER}&robotID=r&key={secret}"))[0] == 101
