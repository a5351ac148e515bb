"""Connection status of an interface, and its end."""

from __future__ import annotations

import asyncio
from typing import cast

import pytest

from rce.client.connection import Connection
from rce.client.interface import Interface
from rce.errors import NotConnected, Unauthorized, Unavailable


class FakeOwner:
    """Robot that is online while it has a connection."""

    def __init__(self) -> None:
        self.name = "a"
        self.connection: Connection | None = cast(Connection, object())
        self.removed: list[tuple[str, str]] = []

    async def remove_interface(self, endpoint: str, tag: str) -> None:
        self.removed.append((endpoint, tag))


@pytest.fixture
def owner() -> FakeOwner:
    return FakeOwner()


@pytest.fixture
def interface(owner: FakeOwner) -> Interface:
    return Interface(owner, "out", "std_msgs/String")


async def test_interface_is_connected_while_it_has_a_peer(interface: Interface) -> None:
    assert not interface.connected
    waiting = asyncio.create_task(interface.wait_connected(20))
    interface._set_status(True)
    await waiting
    assert interface.connected
    await interface.wait_connected(0)
    interface._set_status(False)
    assert not interface.connected


async def test_peer_that_came_and_went_is_remembered(interface: Interface) -> None:
    assert not interface.was_connected
    interface._set_status(True)
    interface._set_status(False)
    assert interface.was_connected
    assert not interface.connected


async def test_lost_socket_disconnects_until_the_next_status(owner: FakeOwner, interface: Interface) -> None:
    interface._set_status(True)
    owner.connection = None
    interface._disconnected()
    assert not interface.connected
    interface._set_status(True)  # received before the socket broke
    assert not interface.connected
    owner.connection = cast(Connection, object())
    interface._set_status(True)
    assert interface.connected


async def test_missing_peer_is_an_error_that_names_the_interface(interface: Interface) -> None:
    with pytest.raises(NotConnected, match=r"a/out has had no peer for 0\.001 s"):
        await interface.wait_connected(0.001)


async def test_end_releases_those_who_wait_with_the_reason(interface: Interface) -> None:
    waiting = asyncio.create_task(interface.wait_connected(20))
    await asyncio.sleep(0)
    interface._end(Unauthorized("the key was revoked"))
    with pytest.raises(Unauthorized, match="revoked"):
        await waiting
    assert not interface.connected


async def test_closed_interface_stays_closed(owner: FakeOwner, interface: Interface) -> None:
    interface._set_status(True)
    await interface.close()
    assert owner.removed == [("a", "out")]
    interface._end(None)
    interface._set_status(True)
    assert not interface.connected
    with pytest.raises(Unavailable, match="a/out has been closed"):
        await interface.wait_connected(20)
