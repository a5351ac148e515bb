"""Addresses, and UNIX sockets with long paths."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path

import pytest

from rce.errors import InvalidRequest
from rce.net.sockets import USER_TIMEOUT, advertised_host, bind_unix_socket, parse_host_port, tune, unix_socket_path


def test_host_and_port() -> None:
    assert parse_host_port("10.0.0.1:9030") == ("10.0.0.1", 9030)
    for malformed in ("9030", ":9030", "m1:", "m1:x"):
        with pytest.raises(ValueError, match=r"HOST:PORT|int"):
            parse_host_port(malformed)


def test_advertised_host() -> None:
    assert advertised_host("10.0.0.1", "") == "10.0.0.1"
    assert advertised_host("0.0.0.0", "m1") == "m1"
    with pytest.raises(InvalidRequest, match="data_address"):
        advertised_host("0.0.0.0", "")


def test_unix_socket_with_a_long_path(tmp_path: Path) -> None:
    directory = tmp_path / ("d" * 200)
    directory.mkdir()
    path = directory / "socket"
    path.touch()
    with bind_unix_socket(path, 0o600) as listener:
        listener.listen()
        assert path.stat().st_mode & 0o777 == 0o600
        with socket.socket(socket.AF_UNIX) as client, unix_socket_path(path) as short:
            client.connect(short)
            listener.accept()[0].close()


def test_only_sockets_are_connected_to(tmp_path: Path) -> None:
    with bind_unix_socket(tmp_path / "socket"):
        (tmp_path / "link").symlink_to(tmp_path / "socket")
        (tmp_path / "file").touch()
        for name in ("link", "file", "missing"):
            with pytest.raises(OSError, match=name), unix_socket_path(tmp_path / name):
                pass


@pytest.mark.parametrize("kind", ["tcp", "unix"])
async def test_tuned_connection_has_the_options_and_stays_open(kind: str) -> None:
    ours, theirs = socket.socketpair() if kind == "unix" else _connected()
    reader, writer = await asyncio.open_connection(sock=ours)
    before = ours.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF)
    tune(writer.transport)
    assert ours.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF) != before
    if kind == "tcp":
        assert ours.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        assert ours.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == USER_TIMEOUT * 1000
    theirs.sendall(b"still open")
    assert await reader.readexactly(10) == b"still open"
    writer.close()
    theirs.close()


def _connected() -> tuple[socket.socket, socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        ours = socket.create_connection(listener.getsockname())
        return ours, listener.accept()[0]
