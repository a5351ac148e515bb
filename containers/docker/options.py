"""Options of an environment's container: its privileges, limits, mounts, networks and variables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from docker.types import DeviceRequest, DriverConfig, LogConfig, Mount, Ulimit
from msgspec import Struct

from containers.docker import seccomp
from containers.docker.block_io import Machine, block_io_limits
from containers.docker.disks import Disk
from containers.docker.networks import Attachments
from containers.endpoint import (
    CONTROL,
    HOME,
    HOME_SIZE,
    INODES,
    LOG_SIZE,
    OPEN_FILES,
    TEMPORARY_SIZE,
    EndpointPaths,
)
from containers.limits import Limits


class ContainerOptions(Struct, frozen=True):
    """Options with which a container is created; `host_config` is in the form of docker-py."""

    user: str
    host_config: dict[str, Any]
    networks: Attachments


def container_options(
    user: int,
    granted: Limits,
    paths: EndpointPaths,
    read_only: Sequence[str],
    networks: Attachments = Attachments(),  # noqa: B008  # frozen
    disk: Disk | None = None,
    machine: Machine = Machine(),  # noqa: B008  # frozen
) -> ContainerOptions:
    """Return the options of a container; `user` is the id it runs as, `read_only` are further directories it sees."""
    sockets = str(paths.socket.parent)
    mounts = [
        Mount(CONTROL, str(paths.control), type="bind", read_only=True),
        Mount(sockets, sockets, type="bind", read_only=True),
        *(Mount(path, path, type="bind", read_only=True) for path in read_only),
    ]
    tmpfs = {"/tmp": f"size={TEMPORARY_SIZE},nr_inodes={INODES},mode=1777"}
    if disk is None:
        tmpfs[HOME] = f"exec,size={HOME_SIZE},nr_inodes={INODES},uid={user},gid={user},mode=0700"
    else:
        mounts.append(_disk_mount(disk, synchronous=bool(granted.io.write) and not machine.limits_buffered_writes))
    config = {
        "network_mode": networks.networks[0].network if networks.networks else "none",
        "dns": list(networks.dns),
        "cap_drop": ["ALL"],
        "security_opt": ["no-new-privileges", f"seccomp={seccomp.profile()}"],
        "read_only": True,
        "mounts": mounts,
        "tmpfs": tmpfs,
        "shm_size": granted.memory,
        "mem_limit": granted.memory,
        "memswap_limit": granted.memory,
        "nano_cpus": int(granted.cpu * 1e9),
        "pids_limit": granted.pids,
        "ulimits": [Ulimit(name="nofile", soft=OPEN_FILES, hard=OPEN_FILES), Ulimit(name="core", soft=0, hard=0)],
        "log_config": LogConfig(type=LogConfig.types.JSON, config={"max-size": LOG_SIZE, "max-file": "2"}),
        "restart_policy": {"Name": "no"},
        **block_io_limits(granted.io, disk, machine),
    }
    if granted.gpus:
        config["device_requests"] = [DeviceRequest(device_ids=granted.gpus, capabilities=[["gpu"]])]
    return ContainerOptions(f"{user}:{user}", config, networks)


def _disk_mount(disk: Disk, synchronous: bool) -> Mount:
    """Return the mount of an anonymous volume, which Docker removes with its container."""
    options = {"type": "ext4", "device": disk.device, "o": "noatime,sync" if synchronous else "noatime"}
    driver = DriverConfig("local", options)
    return Mount(HOME, None, type="volume", no_copy=True, driver_config=driver)
