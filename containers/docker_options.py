"""How the container of an environment is made: what it may do, what it may use, what it sees."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from docker.types import DeviceRequest, DriverConfig, LogConfig, Mount, Ulimit
from msgspec import Struct

from containers.docker_disks import Disk
from containers.docker_networks import Attachments
from containers.limits import Limits
from rce import __version__
from rce.calls.environments import EnvironmentSpec, Group
from rce.messages import Rates
from rce.slots import MB

# In memory, and counted in its limit; so is /dev/shm, where Fast DDS takes a segment for each process: it has no other.
HOME_SIZE, TEMPORARY_SIZE = 256 * MB, 128 * MB
INODES = 50_000  # of each file system in memory
OPEN_FILES = 4096
LOG_SIZE = "2m"
USER = 10000  # the user of the images; a task set that is not root has its own, as it cannot give files away
CONTROL = "/run/rce"  # where the container sees its control directory
HOME = "/home/rce"


class Machine(Struct, frozen=True):
    """What of a machine's Docker matters for the walls."""

    ground: str = ""
    """The device that images are on, empty if unknown."""
    buffered: bool = False
    """Whether a limit on writes holds for those that pass the kernel's cache (cgroup v2); else none may pass it."""


class Places(Struct, frozen=True):
    """What one environment has on the host."""

    control: Path
    """Directory with the socket that leads to the Master; the environment only reads it."""
    socket: Path
    """Where its endpoint takes data links, in a directory that all environments of its user see at this same path."""


class Walls(Struct, frozen=True):
    """`host_config` is as docker-py takes it."""

    user: str
    host_config: dict[str, Any]
    networks: Attachments


def reference(image: str) -> str:
    """An image with its tag: the platform's version, unless it says another."""
    return image if ":" in image.rpartition("/")[2] or "@" in image else f"{image}:{__version__}"


def owner() -> int:
    """The user that environments run as."""
    return USER if os.geteuid() == 0 else os.geteuid()


def walls(
    granted: Limits,
    places: Places,
    read_only: Sequence[str],
    networks: Attachments = Attachments(),  # noqa: B008  # frozen
    disk: Disk | None = None,
    machine: Machine = Machine(),  # noqa: B008  # frozen
) -> Walls:
    """What a container may do, use, see and reach; `read_only` are further directories that it sees."""
    user = owner()
    sockets = str(places.socket.parent)
    mounts = [
        Mount(CONTROL, str(places.control), type="bind", read_only=True),
        Mount(sockets, sockets, type="bind"),
        *(Mount(path, path, type="bind", read_only=True) for path in read_only),
    ]
    tmpfs = {"/tmp": f"size={TEMPORARY_SIZE},nr_inodes={INODES},mode=1777"}
    if disk is None:
        tmpfs[HOME] = f"exec,size={HOME_SIZE},nr_inodes={INODES},uid={user},gid={user},mode=0700"
    else:
        mounts.append(_mounted(disk, synchronous=bool(granted.io.write) and not machine.buffered))
    config = {
        "network_mode": networks.networks[0].network if networks.networks else "none",
        "dns": list(networks.dns),
        "cap_drop": ["ALL"],
        "security_opt": ["no-new-privileges"],
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
        **rates(granted.io, disk, machine),
    }
    if granted.gpus:
        config["device_requests"] = [DeviceRequest(device_ids=granted.gpus, capabilities=[["gpu"]])]
    return Walls(f"{user}:{user}", config, networks)


def _mounted(disk: Disk, synchronous: bool) -> Mount:
    """A nameless volume: it goes with its container."""
    options = {"type": "ext4", "device": disk.device, "o": "noatime,sync" if synchronous else "noatime"}
    driver = DriverConfig("local", options)
    return Mount(HOME, None, type="volume", no_copy=True, driver_config=driver)


def rates(io: Rates, disk: Disk | None, machine: Machine) -> dict[str, list[dict[str, Any]]]:
    """Reads from the image count as well as those from the disk; it is read-only."""
    own = [disk.device] if disk else []
    read = [{"Path": device, "Rate": io.read} for device in (*own, machine.ground) if device and io.read]
    write = [{"Path": device, "Rate": io.write} for device in own if io.write]
    return {"device_read_bps": read, "device_write_bps": write}


def variables(spec: EnvironmentSpec, places: Places, host: str, settings: Mapping[str, str]) -> dict[str, str]:
    """What the Environment endpoint finds in its environment."""
    return {
        **{f"RCE_{key.upper()}": value for key, value in settings.items()},
        "RCE_ENV": msgspec.json.encode(spec.options.env).decode(),
        "HOME": f"{HOME}/home",
        "RCE_NAME": spec.name,
        "RCE_RUN": spec.run,
        "RCE_TOKEN": spec.token,
        "RCE_MASTER": f"unix:{CONTROL}/control.sock",
        "RCE_DATA_DIR": HOME,
        "RCE_HOST": host,
        "RCE_SOCKET": str(places.socket),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        **_in_group(spec.group),
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
    }


def _in_group(group: Group | None) -> dict[str, str]:
    if group is None:
        return {}
    peers = [address for address in group.members.values() if address != group.address]
    return {"RCE_ADDRESS": group.address, "RCE_PEERS": ",".join(peers)}
