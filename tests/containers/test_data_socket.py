"""Listening sockets that the platform makes and gives to environments."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from containers.data_socket import OFFER, DataSocket
from rce.net.sockets import receive_socket, unix_socket_path
from tests.support.containers.trees import names


@pytest.fixture
def control(tmp_path: Path) -> Path:
    (tmp_path / "control").mkdir()
    return tmp_path / "control"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "sockets").mkdir()
    return tmp_path / "sockets" / "run.sock"


@pytest.fixture
async def offered(control: Path, path: Path) -> AsyncIterator[DataSocket]:
    data_socket = DataSocket(path)
    data_socket.offer(control)
    yield data_socket
    data_socket.close()


def reaches(path: Path, listener: socket.socket) -> bool:
    with unix_socket_path(path) as short, socket.socket(socket.AF_UNIX) as client:
        client.connect(short)
        accepted, _ = listener.accept()
        with accepted:
            client.sendall(b"x")
            return accepted.recv(1) == b"x"


async def test_environment_gets_a_socket_that_others_connect_to(offered: DataSocket, control: Path, path: Path) -> None:
    with await asyncio.to_thread(receive_socket, control / OFFER) as listener:
        assert await asyncio.to_thread(reaches, path, listener)


async def test_socket_is_given_once(offered: DataSocket, control: Path) -> None:
    (await asyncio.to_thread(receive_socket, control / OFFER)).close()
    with pytest.raises(OSError, match="no socket was received"):
        await asyncio.to_thread(receive_socket, control / OFFER, 0.0)


async def test_next_task_set_offers_it_again_and_the_earlier_socket_is_kept_until_then(
    offered: DataSocket, control: Path, path: Path
) -> None:
    with await asyncio.to_thread(receive_socket, control / OFFER) as first:
        again = DataSocket(path)
        again.offer(control)
        assert await asyncio.to_thread(reaches, path, first)
        with await asyncio.to_thread(receive_socket, control / OFFER) as second:
            assert await asyncio.to_thread(reaches, path, second)


async def test_socket_that_cannot_be_made_is_offered_again(offered: DataSocket, control: Path, path: Path) -> None:
    path.parent.rmdir()
    with pytest.raises(OSError, match="no socket was received"):
        await asyncio.to_thread(receive_socket, control / OFFER, 0.0)
    path.parent.mkdir()
    (await asyncio.to_thread(receive_socket, control / OFFER)).close()


async def test_removed_socket_refuses_connections(offered: DataSocket, control: Path, path: Path) -> None:
    with await asyncio.to_thread(receive_socket, control / OFFER):
        offered.remove()
        assert names(control) == names(path.parent) == []
