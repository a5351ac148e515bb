"""Limits of an environment's reads from block devices and its writes to them."""

from __future__ import annotations

from typing import Any

from msgspec import Struct

from containers.docker.disks import Disk
from rce.protocol.messages import Rates


class Machine(Struct, frozen=True):
    """Properties of a machine on which container options depend."""

    image_device: str = ""
    """Device that the images are stored on, empty if unknown."""
    limits_buffered_writes: bool = False
    """True if limits on writes include those through the page cache (cgroup v2); else disks are mounted `sync`."""
    maps_users: bool = False
    """True if Docker uses user namespaces, in which only the first 65,536 users exist."""


def block_io_limits(io: Rates, disk: Disk | None, machine: Machine) -> dict[str, list[dict[str, Any]]]:
    """Return Docker's options for limits of reads and writes, in bytes per second.

    Reads are limited on the disk and on the device of the images; writes on the disk, as images are read-only.
    """
    own = [disk.device] if disk else []
    read = [{"Path": device, "Rate": io.read} for device in (*own, machine.image_device) if device and io.read]
    write = [{"Path": device, "Rate": io.write} for device in own if io.write]
    return {"device_read_bps": read, "device_write_bps": write}
