"""Where the other endpoints reach this one's data port."""

from __future__ import annotations

from pathlib import Path

from endpoints.data_port import DataPort


async def listen(port: DataPort, socket: Path, host: str, tcp_port: int = 0) -> list[str]:
    """Take data links at a UNIX socket (an absolute path), and over TCP at `host` if it is given; both addresses."""
    _clear(socket)
    await port.listen_unix(str(socket))
    addresses = [f"unix:{socket}"]
    if host:
        addresses.append(f"tcp:{host}:{await port.listen_tcp(host, tcp_port)}")
    return addresses


def _clear(socket: Path) -> None:
    """Remove what an earlier life has left."""
    socket.unlink(missing_ok=True)
