"""Which machine this is, and where the other endpoints reach this one's data port."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from endpoints.data_port import DataPort

LONGEST_SOCKET_PATH = 100  # sun_path has 108 bytes
LOOPBACK = "127.0.0.1"


def host_identity() -> str:
    """The same for all processes that see this kernel and these files: they can link over UNIX sockets."""
    boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    root = Path("/").stat()
    return hashlib.sha256(f"{boot} {root.st_dev} {root.st_ino}".encode()).hexdigest()[:32]


async def listen(port: DataPort, directory: Path, host: str, tcp_port: int = 0) -> list[str]:
    """Take data links at a UNIX socket in `directory`, and over TCP at `host` if it is given; the addresses of both.

    Where the path is too long for a UNIX socket, TCP at the loopback address stands in for it.
    """
    addresses = []
    path = _free_socket(directory)
    if path:
        await port.listen_unix(path)
        addresses.append(f"unix:{path}")
    if host or not addresses:
        host = host or LOOPBACK
        addresses.append(f"tcp:{host}:{await port.listen_tcp(host, tcp_port)}")
    return addresses


def _free_socket(directory: Path) -> str:
    """Where a UNIX socket can be made, or an empty string."""
    path = directory.absolute() / "data.sock"
    if len(os.fsencode(path)) > LONGEST_SOCKET_PATH:
        return ""
    path.unlink(missing_ok=True)  # of an earlier life
    return str(path)
