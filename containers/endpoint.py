"""Variables and paths of an Environment endpoint in a container, the same for all engines."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import msgspec
from msgspec import Struct

from containers.data_socket import OFFER
from rce import __version__
from rce.control.calls.environments import EnvironmentSpec, Group
from rce.protocol.slots import MB

# File systems in memory, which count towards the memory limit. So does /dev/shm, in which Fast DDS allocates a segment
# for each process; it has no size limit of its own.
HOME_SIZE, TEMPORARY_SIZE = 256 * MB, 128 * MB
INODES = 50_000  # of each file system in memory
OPEN_FILES = 16_384  # of a process; the endpoint needs two for each subscription
LOG_SIZE = "2m"
USER = "rce"  # name for programs that ask for one; the image knows no user with the id of an environment
# The kernel limits some resources for each user of the host, such as inotify instances and pages of pipes. So each user
# of the platform has an id of its own, in a range that the system gives to nobody.
FIRST_USER, USERS = 0x7000_0000, 0x1000_0000
FIRST_MAPPED_USER, MAPPED_USERS = 10_000, 50_000  # where Docker maps the users of containers to others
CONTROL = "/run/rce"  # path of the control directory in the container
HOME = "/home/rce"


class EndpointPaths(Struct, frozen=True):
    """Paths that connect one environment's endpoint to the platform."""

    control: Path
    """Directory with the socket that leads to the Master, read-only for the environment."""
    socket: Path
    """Socket on which its endpoint accepts data links; all environments of its user see its directory at this path,
    read-only."""


def reference(image: str) -> str:
    """Return an image reference with a tag: its own, or else the platform's version."""
    return image if ":" in image.rpartition("/")[2] or "@" in image else f"{image}:{__version__}"


def environment_user(name: str, *, mapped: bool = False) -> int:
    """Return the id of the host's user that the environments of a user run as; `name` is that of an environment.

    With `mapped` it is one of those that exist in a user namespace.
    """
    user = name.partition("/")[0]
    number = int.from_bytes(hashlib.sha256(user.encode()).digest()[:8])
    return FIRST_MAPPED_USER + number % MAPPED_USERS if mapped else FIRST_USER + number % USERS


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
