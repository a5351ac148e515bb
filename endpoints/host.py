"""Where the other endpoints reach this one's data port."""

from __future__ import annotations

from pathlib import Path

from endpoints.data_port import DataPort
from rce.sockets import advertised


async def listen(port: DataPort, socket: Path, host: str = "", tcp_port: int = 0, address: str = "") -> list[str]:
    """Take data links at a UNIX socket (an absolute path), and over TCP at `host` if it is given.

    Returns where others reach them; over TCP that is at `address`, or else at `host`.
    """
    await port.listen_unix(socket)
    addresses = [f"unix:{socket}"]
    if host:
        addresses.append(f"tcp:{advertised(host, address)}:{await port.listen_tcp(host, tcp_port)}")
    return addresses
