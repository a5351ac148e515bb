"""Bandwidth limit on what an environment sends into its networks, enforced by the kernel.

A token bucket filter is set from the host in the container's network namespace. The environment cannot change it, as it
has no capabilities.
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
MIN_BURST = 66 * 1024  # bytes; larger packets never pass, and packets in a group network have up to 65,014
MAX_RATE = 2**32  # bytes per second


def check() -> None:
    """Check that this machine can limit bandwidth.

    Raises:
        InvalidRequest: The task set is not root, or a program is missing.
    """
    lacking = [name for name in PROGRAMS if shutil.which(name, path=PATH) is None]
    if os.geteuid() != 0 or lacking:
        need = (
            f"no {', '.join(lacking)} (apt-get install iproute2 util-linux)" if lacking else "a task set without root"
        )
        raise InvalidRequest(
            f"this machine has {need}, so it cannot limit the bandwidth of a network: leave bandwidth out",
            field="containerData.bandwidth",
        )


def devices(process: int) -> list[str]:
    """Return the network devices of a container, given its first process."""
    lines = Path(f"/proc/{process}/net/dev").read_text().splitlines()[2:]
    return [name for line in lines if (name := line.partition(":")[0].strip()) != "lo"]


def shape(process: int, devices: Sequence[str], rate: int) -> None:
    """Limit each of these network devices of a container to `rate` bytes per second. Blocks.

    Raises:
        StartFailed: `tc` failed.
    """
    burst = max(MIN_BURST, rate // 50)
    for device in devices:
        words = ["qdisc", "replace", "dev", device, "root", "tbf"]
        words += ["rate", f"{min(rate, MAX_RATE)}bps", "burst", str(burst), "latency", f"{LATENCY}ms"]
        inside = ["nsenter", f"--net=/proc/{process}/ns/net", shutil.which("tc", path=PATH) or "tc"]
        done = subprocess.run([*inside, *words], capture_output=True, text=True)
        if done.returncode and Path(f"/proc/{process}").exists():  # if it has ended, its end is reported elsewhere
            raise StartFailed(f"the bandwidth of its network cannot be limited: {done.stderr.strip()}")
