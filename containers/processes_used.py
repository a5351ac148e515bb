"""What trees of processes have used, from one look through /proc."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from rce.calls.watching import Used

_TICKS, _PAGE = os.sysconf("SC_CLK_TCK"), os.sysconf("SC_PAGE_SIZE")


class _Process(NamedTuple):
    pid: int
    seconds: float  # with those of its children that have ended
    memory: int  # resident, with what it shares


def used_below(pids: Collection[int]) -> dict[int, Used]:
    """What each of these processes has used together with all that it and its children have started, by pid.

    Memory that processes share counts for each of them. A process whose parent has ended counts no more.
    """
    found: dict[int, _Process] = {}
    children: dict[int, list[int]] = defaultdict(list)
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                stat = Path(f"/proc/{entry}/stat").read_text()
            except (FileNotFoundError, ProcessLookupError):
                continue  # it has ended meanwhile
            process, parent = _parse(int(entry), stat)
            found[process.pid] = process
            children[parent].append(process.pid)
    return {pid: _sum(pid, found, children) for pid in pids if pid in found}


def _parse(pid: int, stat: str) -> tuple[_Process, int]:
    """See proc_pid_stat(5). The name of a program may have blanks and brackets in it."""
    fields = stat.rpartition(")")[2].split()
    seconds = sum(map(int, fields[11:15])) / _TICKS
    return _Process(pid, seconds, int(fields[21]) * _PAGE), int(fields[1])


def _sum(pid: int, found: dict[int, _Process], children: dict[int, list[int]]) -> Used:
    seconds, memory, below = 0.0, 0, [pid]
    for each in below:
        seconds += found[each].seconds
        memory += found[each].memory
        below += children[each]
    return Used(seconds, memory)
