"""Findings of `doctor`, and the limits by which they are judged. Standard library only."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "warn", "bad"]
GB = 1e9
DAY = 86_400.0


@dataclass(frozen=True)
class Finding:
    """Result of one check.

    Attributes:
        level: Judgement.
        about: Subject of the check.
        found: Observed state.
        remedy: What to do if the level is not "ok".
    """

    level: Level
    about: str
    found: str
    remedy: str = ""

    def line(self) -> str:
        """Return the finding as a line of text."""
        return f"{self.level:<5} {self.about:<21} {self.found}{': ' if self.remedy else ''}{self.remedy}"


def worst(findings: Iterable[Finding]) -> Level:
    """Return the worst level of several findings."""
    levels = {finding.level for finding in findings}
    return "bad" if "bad" in levels else "warn" if "warn" in levels else "ok"


def judge(good: bool, about: str, found: str, remedy: str, otherwise: Level = "bad") -> Finding:
    """Return a finding that is "ok" if `good`, else of level `otherwise`."""
    return Finding("ok", about, found) if good else Finding(otherwise, about, found, remedy)


def amount(about: str, what: str, size: float, enough: float, least: float, remedy: str) -> Finding:
    """Judge an amount in bytes: `enough` is "ok", less than `least` is "bad"."""
    found = f"{size / GB:.1f} GB {what}"
    if size >= enough:
        return Finding("ok", about, found)
    return Finding("warn" if size >= least else "bad", about, found, remedy)


def expiry(about: str, seconds: float, remedy: str) -> Finding:
    """Judge the time in seconds until a certificate expires."""
    days = seconds / DAY
    if days <= 0:
        return Finding("bad", about, f"expired {-days:.0f} days ago", remedy)
    return judge(days > 30, about, f"valid for {days:.0f} days", remedy, "warn")


def clock(seconds: float) -> Finding:
    """Judge by how many seconds the clock is ahead of the Master's. Certificates and join codes have times."""
    found = f"{abs(seconds):.0f} s {'ahead of' if seconds > 0 else 'behind'} the Master's"
    remedy = "synchronize both clocks: apt-get install systemd-timesyncd"
    return judge(abs(seconds) < 5, "clock", found, remedy, "warn" if abs(seconds) < 300 else "bad")


def receive_buffer(most: int) -> Finding:
    """Judge the limit of sockets' receive buffers, in bytes."""
    found = f"receive buffers of up to {most / 1024:.0f} KiB"
    remedy = "large messages in network groups will be slow: sysctl net.core.rmem_max=4194304"
    return judge(most >= 4 * 1024 * 1024, "network groups", found, remedy, "warn")


def docker(info: dict[str, object]) -> Iterator[Finding]:
    """Judge the output of `docker info`."""
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
        f"limits of {', '.join(lacking)} are not enforced" if lacking else "memory, swap, processes, cores",
        "boot with cgroup_enable=memory swapaccount=1, or use cgroup v2",
        "warn" if lacking == ["swap"] else "bad",
    )
    options = " ".join(map(str, info.get("SecurityOptions") or ()))  # type: ignore[call-overload]  # it is a list
    yield judge("seccomp" in options, "seccomp", "on" if "seccomp" in options else "off", "use a kernel with seccomp")
