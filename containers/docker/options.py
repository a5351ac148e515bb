"""Options of an environment's container: its privileges, limits, mounts, networks and variables."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from docker.types import DeviceRequest, DriverConfig, LogConfig, Mount, Ulimit
from msgspec import Struct

from containers.data_socket import OFFER
from containers.docker import seccomp
from containers.docker.disks import Disk
from containers.docker.networks import Attachments
from containers.limits import Limits
from rce import __version__
from rce.control.calls.environments import EnvironmentSpec, Group
from rce.protocol.messages import Rates
from rce.protocol.slots import MB

# File systems in memory, which count towards the memory limit. So does /dev/shm, in which Fast DDS allocates a segment
# for each process; it has no size limit of its own.
HOME_SIZE, TEMPORARY_SIZE = 256 * MB, 128 * MB
INODES = 50_000  # of each file system in memory
OPEN_FILES = 4096
LOG_SIZE = "2m"
USER = "rce"  # name for programs that ask for one; the image knows no user with the id of an environment
# The kernel limits some resources for each user of the host, such as inotify instances and pages of pipes. So each user
# of the platform has an id of its own, in a range that the system gives to nobody.
FIRST_USER, USERS = 0x7000_0000, 0x1000_0000
FIRST_MAPPED_USER, MAPPED_USERS = 10_000, 50_000  # where Docker maps the users of containers to others
CONTROL = "/run/rce"  # path of the control directory in the container
HOME = "/home/rce"


class Machine(Struct, frozen=True):
    """Properties of a machine on which container options depend."""

    image_device: str = ""
    """Device that the images are stored on, empty if unknown."""
    limits_buffered_writes: bool = False
    """True if limits on writes include those through the page cache (cgroup v2); else disks are mounted `sync`."""
    maps_users: bool = False
    """True if Docker uses user namespaces, in which only the first 65,536 users exist."""


class EndpointPaths(Struct, frozen=True):
    """Paths that connect one environment's endpoint to the platform."""

    control: Path
    """Directory with the socket that leads to the Master, read-only for the environment."""
    socket: Path
    """Socket on which its endpoint accepts data links; all environments of its user see its directory at this path,
    read-only."""


class ContainerOptions(Struct, frozen=True):
    """Options with which a container is created; `host_config` is in the form of docker-py."""

    user: str
    host_config: dict[str, Any]
    networks: Attachments


def reference(image: str) -> str:
    """Return an image reference with a tag: its own, or else the platform's version."""
    return image if ":" in image.rpartition("/")[2] or "@" in image else f"{image}:{__version__}"


def environment_user(name: str, machine: Machine = Machine()) -> int:  # noqa: B008  # frozen
    """Return the id of the host's user that the environments of a user run as; `name` is that of an environment."""
    user = name.partition("/")[0]
    number = int.from_bytes(hashlib.sha256(user.encode()).digest()[:8])
    return FIRST_MAPPED_USER + number % MAPPED_USERS if machine.maps_users else FIRST_USER + number % USERS


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


def block_io_limits(io: Rates, disk: Disk | None, machine: Machine) -> dict[str, list[dict[str, Any]]]:
    """Return Docker's options for limits of reads and writes, in bytes per second.

    Reads are limited on the disk and on the device of the images; writes on the disk, as images are read-only.
    """
    own = [disk.device] if disk else []
    read = [{"Path": device, "Rate": io.read} for device in (*own, machine.image_device) if device and io.read]
    write = [{"Path": device, "Rate": io.write} for device in own if io.write]
    return {"device_read_bps": read, "device_write_bps": write}


def variables(spec: EnvironmentSpec, paths: EndpointPaths, host: str, settings: Mapping[str, str]) -> dict[str, str]:
    """Return the environment variables of the Environment endpoint."""
    return {
        **{f"RCE_{key.upper()}": value for key, value in settings.items()},
        "RCE_ENV": msgspec.json.encode(spec.options.env).decode(),
        "HOME": f"{HOME}/home",
        "USER": USER,
        "LOGNAME": USER,
        "RCE_NAME": spec.name,
        "RCE_RUN": spec.run,
        "RCE_TOKEN": spec.token,
        "RCE_MASTER": f"unix:{CONTROL}/control.sock",
        "RCE_DATA_DIR": HOME,
        "RCE_HOST": host,
        "RCE_SOCKET": str(paths.socket),
        "RCE_LISTENER": f"{CONTROL}/{OFFER}",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        **_group_variables(spec.group),
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
    }


def _group_variables(group: Group | None) -> dict[str, str]:
    if group is None:
        return {}
    peers = [address for address in group.members.values() if address != group.address]
    return {"RCE_ADDRESS": group.address, "RCE_PEERS": ",".join(peers)}
