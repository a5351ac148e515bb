"""Listening for robots: bounds on sockets without a login, and TLS."""

from __future__ import annotations

import asyncio
import ssl
from pathlib import Path

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException

from endpoints.robot import server
from rce.net import pending_logins
from rce.net.certificates import Authority
from rce.net.tls import CA, CERTIFICATE, KEY, public_tls_context
from tests.support.certificates import certify
from tests.support.dripping import drip
from tests.support.endpoints.platforms import Platform
from tests.support.endpoints.raw_robot import PASSWORD, USER, Robot, eventually


async def test_dripping_handshake_is_cut_off(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "HANDSHAKE_TIMEOUT", 0.2)
    listener = await server.listen(platform.endpoint, "127.0.0.1", 0, None)
    assert await drip(listener.port) == b""
    listener.close()


async def test_sockets_without_login_are_bounded(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pending_logins, "MAX_PENDING", 2)
    monkeypatch.setattr(pending_logins, "network", lambda address: address)
    robots = [await platform.robot(name) for name in ("a", "b", "c")]
    silent = [await asyncio.open_connection("127.0.0.1", platform.port) for _ in range(2)]
    await eventually(lambda: len(platform.server.pending) == 2)
    with pytest.raises((ConnectionError, WebSocketException)):
        await platform.robot("d")
    for _, writer in silent:
        writer.close()
    await eventually(lambda: len(platform.server.pending) == 0)
    robots.append(await platform.robot("d"))
    for robot in robots:
        await robot.expect_silence()


async def test_wss(platform: Platform, tmp_path: Path) -> None:
    own = certify(tmp_path / "own", Authority.make("rce"), ["localhost"])
    secure = await server.listen(
        platform.endpoint, "127.0.0.1", 0, public_tls_context(str(own / CERTIFICATE), str(own / KEY))
    )
    port = secure.port
    trust = ssl.create_default_context(cafile=str(own / CA))
    url = f"wss://localhost:{port}/?userID={USER}&robotID=a&password={PASSWORD}"
    async with connect(url, ssl=trust, max_size=None, host="127.0.0.1", server_hostname="localhost") as socket:
        a = Robot("a", socket)
        await a.expect_silence()
        await a.add("out", "SubscriberConverter")
        await a.add("in", "PublisherConverter")
        await a.connect("a/out", "a/in")
        await a.receive_all(2)
        await a.data("out", {"data": "x" * 3_000_000})
        assert len((await a.receive())["data"]["msg"]["data"]) == 3_000_000
    secure.close()
