"""Which machine this is."""

from __future__ import annotations

import hashlib
from pathlib import Path


def host_identity() -> str:
    """The same for all processes that see this kernel and these files: they can link over UNIX sockets."""
    boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    root = Path("/").stat()
    return hashlib.sha256(f"{boot} {root.st_dev} {root.st_ino}".encode()).hexdigest()[:32]
