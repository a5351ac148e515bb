"""Connection set-up: the request to the entry, the handshake, and their errors."""

from __future__ import annotations

import asyncio
import logging
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest

from rce.client import Robot
from rce.client.address import Address
from rce.errors import InvalidName, InvalidRequest, NotFound, Unauthorized, Unavailable
from tests.support.fake_platform import KEY, PASSWORD_HASH, FakePlatform

UNUSED = "http://127.0.0.1:9/"  # the discard port, at which nothing listens


async def test_contents_of_request_and_handshake(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        assert a.features == {"ack", "events", "resume", "parts"}
    entry, socket = fake.request_paths
    assert entry == "/?userID=testUser&version=20130902"
    assert parse_qs(urlsplit(socket).query) == {
        "userID": ["testUser"],
        "robotID": ["a"],
        "password": [PASSWORD_HASH],
        "features": ["ack,events,parts,resume"],
    }


async def test_api_key_in_place_of_password(fake: FakePlatform) -> None:
    async with Robot(fake.url, user="testUser", robot="a", key=KEY) as a:
        assert a.connected


@pytest.mark.parametrize("secret", [{"password": "wrong"}, {"key": "wrong"}])
async def test_wrong_credentials_are_unauthorized(fake: FakePlatform, secret: dict[str, Any]) -> None:
    with pytest.raises(Unauthorized, match="wrong password"):
        await Robot(fake.url, user="testUser", robot="a", **secret).open()


async def test_unknown_owner_is_not_found(fake: FakePlatform) -> None:
    fake.refuse_robots(404, "there is no user 'eve'")
    with pytest.raises(NotFound, match="eve"):
        await fake.robot().open()


def test_malformed_address_is_rejected() -> None:
    with pytest.raises(InvalidRequest, match="http"):
        Robot("ws://x/", user="u", robot="a", password="p")
    with pytest.raises(InvalidRequest, match="either a password or an API key"):
        Robot("http://x/", user="u", robot="a")
    with pytest.raises(InvalidRequest, match="either a password or an API key"):
        Robot("http://x/", user="u", robot="a", password="p", key="k")
    with pytest.raises(InvalidName):
        Robot("http://x/", user="u", robot="1a", password="p")


@pytest.mark.parametrize(
    ("body", "reason"), [("<html>", "not the entry"), ('{"url": "http://x/"}', "not a WebSocket URL")]
)
async def test_server_that_is_no_entry_is_unavailable(fake: FakePlatform, body: str, reason: str) -> None:
    fake.entry_body = body
    with pytest.raises(Unavailable, match=reason):
        await fake.robot().open()


async def test_unreachable_entry_and_endpoint_are_unavailable(fake: FakePlatform) -> None:
    with pytest.raises(Unavailable, match="cannot reach"):
        await Robot(UNUSED, user="u", robot="a", password="p").open()
    fake.entry_body = '{"url": "ws://127.0.0.1:9/"}'
    with pytest.raises(Unavailable, match="cannot reach"):
        await fake.robot().open()


async def test_robot_connects_through_the_master_that_leads(fake: FakePlatform) -> None:
    """The others are unreachable, or standbys, whose entries answer with 503."""

    async def refuse(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"HTTP/1.1 503 Unavailable\r\nContent-Length: 9\r\n\r\na standby")
        writer.close()

    async with await asyncio.start_server(refuse, "127.0.0.1", 0) as standby:
        other = f"http://127.0.0.1:{standby.sockets[0].getsockname()[1]}/"
        address = Address(f"http://127.0.0.1:1/,{other},{fake.url}", "testUser", "r", "testUser")
        assert (await address.locate()).startswith("ws://")
        with pytest.raises(Unavailable, match="a standby"):
            await Address(other, "testUser", "r", "testUser").locate()


async def test_credentials_are_not_logged(fake: FakePlatform, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG):
        async with fake.robot() as a:
            events = a.events()
            fake.break_socket("a")
            await events.get(10)
            await events.get(10)
    assert PASSWORD_HASH not in "".join(
        record.getMessage() for record in caplog.records if not record.name.startswith("websockets.server")
    )
