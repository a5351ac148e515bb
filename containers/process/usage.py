"""Resource usage of process trees, from one pass over /proc."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from rce.control.calls.watching import EnvironmentUsage

_TICKS, _PAGE = os.sysconf("SC_CLK_TCK"), os.sysconf("SC_PAGE_SIZE")


class _Process(NamedTuple):
    pid: int
    seconds: float  # including its children that have ended
    memory: int  # resident, including shared memory


def used_below(pids: Collection[int]) -> dict[int, EnvironmentUsage]:
    """Return the resources that each of these processes and its descendants have used, by pid.

    Shared memory counts for each process. Processes whose parent has ended are not counted.
    """
    found: dict[int, _Process] = {}
    children: dict[int, list[int]] = defaultdict(list)
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                stat = Path(f"/proc/{entry}/stat").read_text()
            except (FileNotFoundError, ProcessLookupError):
                continue  # the process has ended meanwhile
            process, parent = _parse(int(entry), stat)
            found[process.pid] = process
            children[parent].append(process.pid)
    return {pid: _sum(pid, found, children) for pid in pids if pid in found}


def _parse(pid: int, stat: str) -> tuple[_Process, int]:
    """Parse /proc/pid/stat, see proc_pid_stat(5); the program's name may contain blanks and brackets."""
    fields = stat.rpartition(")")[2].split()
    seconds = sum(map(int, fields[11:15])) / _TICKS
    return _Process(pid, seconds, int(fields[21]) * _PAGE), int(fields[1])


def _sum(pid: int, found: dict[int, _Process], children: dict[int, list[int]]) -> EnvironmentUsage:
    seconds, memory, below = 0.0, 0, [pid]
    for each in below:
        seconds += found[each].seconds
        memory += found[each].memory
        below += children[each]
    return EnvironmentUsage(seconds, memory)
