"""What an environment sends into its networks, held to its bandwidth by the kernel.

The queueing discipline is set from the host in the container's network name space, where the environment, which has no
capabilities, cannot change it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from rce.errors import InvalidRequest, StartFailed

PROGRAMS = ("tc", "nsenter")
PATH = f"{os.environ.get('PATH', os.defpath)}:/usr/sbin:/sbin"
LATENCY = 200  # ms that a packet may wait before it is dropped
LEAST_BURST = 66 * 1024  # bytes; what is larger than this never gets through, and packets in a group have up to 65,014
MOST = 2**32  # bytes a second


def check() -> None:
    """InvalidRequest if this machine cannot do it."""
    lacking = [name for name in PROGRAMS if shutil.which(name, path=PATH) is None]
    if os.geteuid() != 0 or lacking:
        need = (
            f"no {', '.join(lacking)} (apt-get install iproute2 util-linux)" if lacking else "a task set without root"
        )
        raise InvalidRequest(
            f"this machine has {need}, and so cannot hold a network to a bandwidth: leave bandwidth out",
            field="containerData.bandwidth",
        )


def devices(process: int) -> list[str]:
    """The networks of a container, by its first process."""
    lines = Path(f"/proc/{process}/net/dev").read_text().splitlines()[2:]
    return [name for line in lines if (name := line.partition(":")[0].strip()) != "lo"]


def shape(process: int, devices: Sequence[str], rate: int) -> None:
    """Hold each of these networks of a container to `rate` bytes a second. Blocks. StartFailed."""
    burst = max(LEAST_BURST, rate // 50)
    for device in devices:
        words = ["qdisc", "replace", "dev", device, "root", "tbf"]
        words += ["rate", f"{min(rate, MOST)}bps", "burst", str(burst), "latency", f"{LATENCY}ms"]
        inside = ["nsenter", f"--net=/proc/{process}/ns/net", shutil.which("tc", path=PATH) or "tc"]
        done = subprocess.run([*inside, *words], capture_output=True, text=True)
        if done.returncode and Path(f"/proc/{process}").exists():  # else it has ended, which is told by others
            raise StartFailed(f"its network cannot be held to its bandwidth: {done.stderr.strip()}")
