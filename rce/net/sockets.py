"""Socket helpers for data links: buffer sizes and timeouts, addresses, and UNIX sockets with long paths."""

from __future__ import annotations

import asyncio
import os
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rce.errors import InvalidRequest

SOCKET_BUFFER = 1024 * 1024  # bytes; with four times as much, small messages wait twice as long, at equal throughput
# Seconds until a peer that vanished is noticed: USER_TIMEOUT while unacknowledged data is in flight, else KEEPALIVE.
KEEPALIVE = {socket.TCP_KEEPIDLE: 10, socket.TCP_KEEPINTVL: 5, socket.TCP_KEEPCNT: 2}
USER_TIMEOUT = 20
RECEIVE_TIMEOUT, RECEIVE_INTERVAL = 30.0, 0.1  # seconds, for `receive_socket`


def tune(transport: asyncio.BaseTransport) -> None:
    """Set buffer sizes for large messages, disable Nagle's algorithm, and set the timeouts for vanished peers."""
    given: socket.socket | None = transport.get_extra_info("socket")
    if given is None:
        return
    # That of uvloop makes a socket object for each option, which takes longer than setting it.
    sock = socket.socket(given.family, given.type, given.proto, given.fileno())
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BUFFER)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SOCKET_BUFFER)
        if sock.family in (socket.AF_INET, socket.AF_INET6):
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            for option, seconds in KEEPALIVE.items():
                sock.setsockopt(socket.IPPROTO_TCP, option, seconds)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, USER_TIMEOUT * 1000)
    finally:
        sock.detach()


def parse_host_port(address: str) -> tuple[str, int]:
    """Split `HOST:PORT` into host and port.

    Raises:
        ValueError: The text does not have this form.
    """
    host, _, port = address.rpartition(":")
    if not host:
        raise ValueError(f"{address!r} is not HOST:PORT")
    return host, int(port)


def advertised_host(host: str, address: str) -> str:
    """Return the host name or IP address by which other machines dial a port.

    Args:
        host: Address at which the port listens (setting `data_host`).
        address: Configured address (setting `data_address`); empty if it is `host`.

    Raises:
        InvalidRequest: `host` means all addresses, and no address is configured.
    """
    if not address and host in ("0.0.0.0", "::"):
        raise InvalidRequest(
            f"data_host is {host}, which means all addresses: set data_address to the one that other machines dial"
        )
    return address or host


def bind_unix_socket(path: Path, mode: int | None = None) -> socket.socket:
    """Bind a UNIX socket to `path`, replacing an earlier file; `mode` sets its permissions.

    Raises:
        OSError: The socket cannot be created.
    """
    listener = socket.socket(socket.AF_UNIX)
    # The path of the directory may exceed the 107 bytes of a socket address, so it is reached by its descriptor.
    handle = os.open(path.parent, os.O_PATH | os.O_DIRECTORY)
    try:
        path.unlink(missing_ok=True)
        listener.bind(f"/proc/self/fd/{handle}/{path.name}")
        if mode is not None:
            path.chmod(mode)
    except OSError:
        listener.close()
        raise
    finally:
        os.close(handle)
    return listener


@contextmanager
def unix_socket_path(path: Path) -> Iterator[str]:
    """Yield a short path by which to connect to the UNIX socket at `path`, however long that is.

    Symbolic links are not followed: environments create files in some of these directories, and a link could lead to
    any socket of the host.

    Raises:
        OSError: There is no socket at `path`.
    """
    handle = os.open(path, os.O_PATH | os.O_NOFOLLOW)
    try:
        if not stat.S_ISSOCK(os.fstat(handle).st_mode):
            raise ConnectionRefusedError(f"{path} is not a socket")
        yield f"/proc/self/fd/{handle}"
    finally:
        os.close(handle)


def send_socket(connection: socket.socket, passed: socket.socket) -> None:
    """Pass a socket to the process at the other end of a UNIX connection.

    Raises:
        OSError: It cannot be sent.
    """
    socket.send_fds(connection, [b"\0"], [passed.fileno()])


def receive_socket(path: Path, timeout: float = RECEIVE_TIMEOUT) -> socket.socket:
    """Receive the socket that a process passes to whoever connects to `path`. Blocks.

    That process may be restarting, so connecting is tried again until the time is over.

    Raises:
        OSError: No socket was passed in time.
    """
    until = time.monotonic() + timeout
    while True:
        try:
            return _receive_socket(path, timeout)
        except OSError as error:
            if time.monotonic() > until:
                raise OSError(f"no socket was received from {path}: {error}") from None
        time.sleep(RECEIVE_INTERVAL)


def _receive_socket(path: Path, timeout: float) -> socket.socket:
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(timeout)
        with unix_socket_path(path) as short:
            connection.connect(short)
        _, passed, _, _ = socket.recv_fds(connection, 1, 1)
    if not passed:
        raise ConnectionResetError("the connection was closed")
    return socket.socket(fileno=passed[0])
