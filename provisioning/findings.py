"""What `doctor` finds. Standard library only."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "warn", "bad"]
GB = 1e9
DAY = 86_400.0


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at: `about` what, what was found, and what to do if it is not well."""

    level: Level
    about: str
    found: str
    remedy: str = ""

    def line(self) -> str:
        return f"{self.level:<5} {self.about:<21} {self.found}{': ' if self.remedy else ''}{self.remedy}"


def worst(findings: Iterable[Finding]) -> Level:
    levels = {finding.level for finding in findings}
    return "bad" if "bad" in levels else "warn" if "warn" in levels else "ok"


def judge(good: bool, about: str, found: str, remedy: str, otherwise: Level = "bad") -> Finding:
    return Finding("ok", about, found) if good else Finding(otherwise, about, found, remedy)


def amount(about: str, what: str, size: float, enough: float, least: float, remedy: str) -> Finding:
    """Of bytes: `enough` is well, below `least` the platform does not work."""
    found = f"{size / GB:.1f} GB {what}"
    if size >= enough:
        return Finding("ok", about, found)
    return Finding("warn" if size >= least else "bad", about, found, remedy)


def expiry(about: str, seconds: float, remedy: str) -> Finding:
    """Of a certificate: how long it is still good."""
    days = seconds / DAY
    if days <= 0:
        return Finding("bad", about, f"has been out of date for {-days:.0f} days", remedy)
    return judge(days > 30, about, f"good for {days:.0f} days", remedy, "warn")


def clock(seconds: float) -> Finding:
    """By how much this machine's clock is ahead of the Master's: certificates and join codes have times."""
    found = f"{abs(seconds):.0f} s {'ahead of' if seconds > 0 else 'behind'} the Master's"
    remedy = "let both keep time: apt-get install systemd-timesyncd"
    return judge(abs(seconds) < 5, "clock", found, remedy, "warn" if abs(seconds) < 300 else "bad")


def receive_buffer(most: int) -> Finding:
    """Of a socket, in bytes."""
    found = f"sockets may have {most / 1024:.0f} KiB to receive in"
    remedy = "large messages between members of network groups get slow: sysctl net.core.rmem_max=4194304"
    return judge(most >= 4 * 1024 * 1024, "network groups", found, remedy, "warn")


def docker(info: dict[str, object]) -> Iterator[Finding]:
    """What `docker info` says."""
    version = str(info.get("ServerVersion", "0"))
    yield judge(
        int(version.partition(".")[0] or 0) >= 20,
        "docker",
        f"Docker {version}",
        "20.10 or later is needed: apt-get upgrade",
    )
    lacking = [
        what
        for what, key in {
            "memory": "MemoryLimit",
            "swap": "SwapLimit",
            "processes": "PidsLimit",
            "cores": "CpuCfsQuota",
        }.items()
        if not info.get(key)
    ]
    yield judge(
        not lacking,
        "cgroup limits",
        f"of {', '.join(lacking)} are not enforced" if lacking else "memory, swap, processes, cores",
        "boot with cgroup_enable=memory swapaccount=1, or use cgroup v2",
        "warn" if lacking == ["swap"] else "bad",
    )
    options = " ".join(map(str, info.get("SecurityOptions") or ()))  # type: ignore[call-overload]  # it is a list
    yield judge("seccomp" in options, "seccomp", "on" if "seccomp" in options else "off", "use a kernel with seccomp")
