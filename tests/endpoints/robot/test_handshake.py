"""Login at the WebSocket, and the HTTP status of each refusal (the table of the original protocol)."""

from __future__ import annotations

import asyncio
import hashlib
from collections import Counter
from contextlib import suppress

import pytest
from autobahn.websocket.types import ConnectionDeny, ConnectionRequest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from endpoints.robot.client import RobotClient
from endpoints.robot.client_socket import ClientSocket
from endpoints.robot.endpoint import LoginResult
from endpoints.robot.handshake import LoginRequest
from master.access.throttle import Throttle
from rce.net.pending_logins import PendingLogin
from rce.net.writer import Passes
from tests.support.endpoints.platforms import Platform
from tests.support.endpoints.raw_robot import LOGIN_QUERY, PASSWORD, USER, WAIT, WEBSOCKET_HEADERS, eventually
from tests.support.fuzz.robot_frames import frame

GUEST_QUERY = LOGIN_QUERY.replace("robotID=r", "robotID=%40r")
ADMIN = f"userID=admin&password={hashlib.sha256(b'admin').hexdigest()}"


async def handshake(port: int, query: str, *headers: str) -> tuple[int, str]:
    """Return status and reason of a handshake with this query."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    lines = "".join(f"{header}\r\n" for header in headers)
    writer.write(f"GET /?{query} HTTP/1.1\r\n{WEBSOCKET_HEADERS}{lines}\r\n".encode())
    answer = await asyncio.wait_for(reader.readline(), WAIT)
    writer.close()
    _, status, reason = answer.decode().split(" ", 2)
    return int(status), reason.strip()


TABLE = [
    (f"robotID=r&password={PASSWORD}", 400, "userID"),
    (f"userID={USER}&password={PASSWORD}", 400, "robotID"),
    (f"userID={USER}&robotID=r", 400, "password"),
    (f"{LOGIN_QUERY}&userID={USER}", 400, "userID"),
    (f"{LOGIN_QUERY}&robotID=r", 400, "robotID"),
    (f"{LOGIN_QUERY}&password=x", 400, "password"),
    (f"{LOGIN_QUERY}&key=x", 400, "password"),
    (f"{LOGIN_QUERY}&resume=a&resume=b", 400, "resume"),
    (f"{LOGIN_QUERY}&compress=zip", 400, "compress"),
    (f"{LOGIN_QUERY}&features=ack&features=ack", 400, "features"),
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
    (f"{GUEST_QUERY}&owner=admin&features=ack", 404, "no user admin"),
    (f"{GUEST_QUERY}&owner={USER}", 101, ""),
    (f"{ADMIN}&robotID=%40s&owner={USER}", 101, ""),
    (f"{ADMIN}&robotID=%40s", 101, ""),
    (LOGIN_QUERY, 101, ""),
    (LOGIN_QUERY.replace("password", "key"), 101, ""),
    (LOGIN_QUERY + "&features=ack,unknown&more=1", 101, ""),
]


async def test_status_and_reason_of_each_query(platform: Platform) -> None:
    for query, status, names in TABLE:
        got, reason = await handshake(platform.port, query)
        assert (got, names in reason) == (status, True), f"{query}: {got} {reason}"
        assert PASSWORD not in reason
        await platform.forget("r")


async def test_refusal_as_close_code_on_request(platform: Platform) -> None:
    for query, status, words in TABLE:
        if status != 101:
            async with connect(f"ws://127.0.0.1:{platform.port}/?{query}&refuse=close") as socket:
                with pytest.raises(ConnectionClosed):
                    await asyncio.wait_for(socket.recv(), WAIT)
            assert socket.close_code == 4000 + status, query
            assert words in (socket.close_reason or "")


async def test_credential_in_authorization_header(platform: Platform) -> None:
    assert await handshake(platform.port, f"userID={USER}&robotID=a", f"Authorization: Bearer {PASSWORD}") == (
        101,
        "Switching Protocols",
    )
    assert (await handshake(platform.port, f"userID={USER}&robotID=b", "Authorization: Bearer x"))[0] == 401


@pytest.mark.parametrize("origin", ["null", "https://example.com", "file://"])
async def test_pages_of_any_origin_are_accepted(platform: Platform, origin: str) -> None:
    """Pages from files have the origin `null`. A page has only the credentials that its user gives it."""
    assert (await handshake(platform.port, LOGIN_QUERY, f"Origin: {origin}"))[0] == 101


async def test_api_key_is_accepted_for_its_user_only(platform: Platform) -> None:
    secret, _ = await platform.master.users.keys.add(USER)
    assert (await handshake(platform.port, f"userID={USER}&robotID=a&key={secret}"))[0] == 101
    assert (await handshake(platform.port, f"userID=admin&robotID=a&key={secret}"))[0] == 401
    assert (await handshake(platform.port, f"userID=&robotID=b&key={secret}"))[0] == 400  # a robot has its user's name


async def test_refused_connection_that_is_lost_is_not_opened(platform: Platform) -> None:
    """Autobahn would open it, close it with the code, and fail to drop it a second later."""
    endpoint = platform.endpoint
    socket = ClientSocket(
        endpoint.switchboard.turns, Passes(), lambda _: RobotClient(endpoint), PendingLogin(Counter(), "")
    )
    socket.transport = None
    request = ConnectionRequest("tcp4:x", {}, "", "/", {"refuse": ["close"]}, 13, "", [], [])
    with pytest.raises(ConnectionDeny):
        await socket.onConnect(request)
    socket.succeedHandshake((None, {}))  # it would fail if it sent an answer


async def test_messages_that_come_during_the_login_are_no_second_request(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    logins, go = [], asyncio.Event()
    login = platform.endpoint.login

    async def slow(request: LoginRequest) -> LoginResult:
        logins.append(request)
        await go.wait()
        return await login(request)

    monkeypatch.setattr(platform.endpoint, "login", slow)
    reader, writer = await asyncio.open_connection("127.0.0.1", platform.port)
    request = f"GET /?{LOGIN_QUERY} HTTP/1.1\r\n{WEBSOCKET_HEADERS}\r\n".encode()
    writer.write(request)
    await eventually(lambda: bool(logins))
    writer.write(frame(b"no JSON\r\n\r\n") + frame(b"last", 9))
    await asyncio.sleep(0.01)  # so that it arrives before the login ends; the test passes without it too
    go.set()
    answer = await asyncio.wait_for(reader.readuntil(b"last"), WAIT)  # the pong
    assert answer.startswith(b"HTTP/1.1 101")
    assert b"not a JSON object" in answer
    assert len(logins) == 1
    writer.close()


async def test_robot_id_in_use_is_refused(platform: Platform) -> None:
    await platform.robot("r")
    status, reason = await handshake(platform.port, LOGIN_QUERY)
    assert (status, "in use" in reason) == (400, True)
    assert (await handshake(platform.port, LOGIN_QUERY + "&resume=" + "0" * 64))[0] == 400


async def test_endless_request_is_cut_off(platform: Platform) -> None:
    """Clients that are not logged in must not consume memory."""
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


async def test_failed_logins_are_rate_limited(platform: Platform) -> None:
    platform.master.users.throttle = Throttle(lambda: 0.0)
    secret, _ = await platform.master.users.keys.add(USER)
    for user in (USER, "nobody"):
        wrong = f"userID={user}&robotID=r&password={'0' * 64}"
        answers = [await handshake(platform.port, wrong) for _ in range(6)]
        assert [status for status, _ in answers] == [401] * 5 + [429]
        assert "try again in 1 s" in answers[-1][1]
    assert (await handshake(platform.port, LOGIN_QUERY))[0] == 429
    assert (await handshake(platform.port, f"userID={USER}&robotID=r&key={secret}"))[0] == 101
