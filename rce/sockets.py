"""Sockets as data links need them: found whatever the length of their path, tuned for large and small messages."""

from __future__ import annotations

import asyncio
import os
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rce.errors import InvalidRequest

SOCKET_BUFFER = 1024 * 1024  # four times this doubles the time for which a small message waits, and carries no more
# A peer that was cut off is noticed, in seconds: while data waits for it by the last of these, else by the others.
KEEPALIVE = {socket.TCP_KEEPIDLE: 10, socket.TCP_KEEPINTVL: 5, socket.TCP_KEEPCNT: 2}
USER_TIMEOUT = 20


def tune(transport: asyncio.BaseTransport) -> None:
    """Large socket buffers for large messages, no delay for small ones, and an end where nobody answers any more."""
    sock: socket.socket | None = transport.get_extra_info("socket")
    if sock is None:
        return
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BUFFER)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SOCKET_BUFFER)
    if sock.family in (socket.AF_INET, socket.AF_INET6):
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, seconds in KEEPALIVE.items():
            sock.setsockopt(socket.IPPROTO_TCP, option, seconds)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, USER_TIMEOUT * 1000)


def split(address: str) -> tuple[str, int]:
    """`HOST:PORT` as its parts; ValueError."""
    host, _, port = address.rpartition(":")
    if not host:
        raise ValueError(f"{address!r} is not HOST:PORT")
    return host, int(port)


def advertised(host: str, address: str) -> str:
    """The name or IP address by which others dial what listens at `host`. InvalidRequest if it cannot be known."""
    if not address and host in ("0.0.0.0", "::"):
        raise InvalidRequest(f"data_host is {host}, all addresses: say by data_address which one others shall dial")
    return address or host


def bound(path: Path, mode: int | None = None) -> socket.socket:
    """A socket bound to `path`, in the place of an earlier one; OSError. With `mode`, as chmod would give it."""
    listener = socket.socket(socket.AF_UNIX)
    handle = os.open(path.parent, os.O_PATH | os.O_DIRECTORY)  # the whole path may be too long for a socket's
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
def reaching(path: Path) -> Iterator[str]:
    """A path by which to connect to the socket at `path`; OSError if there is none.

    A symbolic link is not followed: where environments make their sockets, it might lead to any socket of the host.
    """
    handle = os.open(path, os.O_PATH | os.O_NOFOLLOW)
    try:
        if not stat.S_ISSOCK(os.fstat(handle).st_mode):
            raise ConnectionRefusedError(f"{path} is no socket")
        yield f"/proc/self/fd/{handle}"
    finally:
        os.close(handle)
