"""Full disks of services."""

from __future__ import annotations

import errno

from rce.errors import DiskFull


def service_disk_full(error: BaseException) -> DiskFull | None:
    """Return the error for clients if `error` means that the disk is full, though there was room before; else None."""
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return DiskFull("disk full (service): received data is kept, so continue when there is room")
    return None
