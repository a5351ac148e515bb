"""Cores of processes: those that are measured have cores of their own, so that no other takes time from them."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache

import psutil


def set_apart(measured: Callable[[psutil.Process], bool]) -> None:
    """Run the measured processes on all cores but the first, and the others on the first.

    The processes are this one and its descendants. While a process computes, a kernel that preempts at its ticks only
    lets others on the same core wait for up to 4 ms. Processes that start later have the cores of their parents until
    the next call. A machine with one core stays as it is.

    Args:
        measured: Returns whether a process is measured.
    """
    first, *others = _cores()
    if not others:
        return
    this = psutil.Process()
    for process in (this, *this.children(recursive=True)):
        with suppress(psutil.NoSuchProcess, ProcessLookupError):
            cores = others if measured(process) else [first]
            for thread in process.threads():
                os.sched_setaffinity(thread.id, cores)


def runs(process: psutil.Process, module: str) -> bool:
    """Return whether a process was started as `python -m MODULE`."""
    words = process.cmdline()
    return "-m" in words and words[words.index("-m") + 1] == module


@cache
def _cores() -> list[int]:
    """Return the cores that this process had at first."""
    return sorted(os.sched_getaffinity(0))
