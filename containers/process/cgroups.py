"""Control groups (cgroups(7)): limits of memory, processes and cores for the environments of a process engine.

The group of the engine is the topmost one that this user may make, and has a group for each run of an environment. As
root that is beside the groups of the system; for a user it is within those that systemd has delegated. Both versions of
control groups are supported. Where no group can be made, nothing is limited.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path

from rce.errors import TimedOut
from rce.protocol.messages import ContainerData

MOUNTS = Path("/sys/fs/cgroup")
OWN = Path("/proc/self/cgroup")  # the groups of this process
CONTROLLERS = ("memory", "pids", "cpu")  # named as the options that they limit
PERIOD = 100_000  # microseconds, in which the processes of a group may run for a share of the cores
KILL_TIMEOUT = 5.0  # seconds
PROCESSES = "cgroup.procs"


class ControlGroups:
    """Control groups of the runs of one engine. All methods block for a moment."""

    def __init__(self, name: str, mounts: Path = MOUNTS, own: Path = OWN) -> None:
        """Prepare without touching anything.

        Args:
            name: Name of the engine's group.
            mounts: Directory with the hierarchies of control groups.
            own: File with the groups of this process.
        """
        self._name = name
        self._mounts = mounts
        self._own = own
        self._groups: dict[str, Path] = {}  # the engine's, by controller
        self._unified = False  # version 2

    @property
    def enforced(self) -> frozenset[str]:
        """Names of the options that are enforced."""
        return frozenset(self._groups)

    def open(self, keep: Collection[str]) -> None:
        """Make the engine's group where that is possible, and remove the groups of all runs but those to keep."""
        for line in self._own.read_text().splitlines() if self._own.exists() else []:
            _, controllers, path = line.split(":", 2)
            if controllers:
                self._open_hierarchy(controllers, path.strip("/"))
            elif not self._groups:
                self._open_unified(path.strip("/"))
        for run in {path.name for group in self._groups.values() for path in group.iterdir() if path.is_dir()}:
            if run not in keep:
                self.remove(run)

    def _open_hierarchy(self, controllers: str, path: str) -> None:
        """Make the engine's group in a hierarchy of version 1."""
        for controller in {*CONTROLLERS}.intersection(controllers.split(",")):
            for place in _from_the_top(self._mounts / controllers, path):
                with suppress(OSError):
                    (place / self._name).mkdir(exist_ok=True)
                    self._groups[controller] = place / self._name
                    break

    def _open_unified(self, path: str) -> None:
        """Make the engine's group in the hierarchy of version 2."""
        for place in _from_the_top(self._mounts, path):
            group = place / self._name
            try:
                _enable(place)
                group.mkdir(exist_ok=True)
                found = _enable(group)
            except OSError:
                continue
            if found:
                self._groups = dict.fromkeys(found, group)
                self._unified = True
                return
            group.rmdir()

    def create(self, run: str, options: ContainerData) -> None:
        """Create the group of a run with the limits of its options.

        Raises:
            OSError: A limit is invalid, or the group cannot be made.
        """
        for group in {*self._groups.values()}:
            (group / run).mkdir(exist_ok=True)
        for controller, group in self._groups.items():
            for file, value in self._limits(controller, options):
                (group / run / file).write_text(value)

    def _limits(self, controller: str, options: ContainerData) -> Iterator[tuple[str, str]]:
        """Yield the files of a controller that set the limits of options, with their values."""
        if controller == "memory" and options.memory:
            yield "memory.max" if self._unified else "memory.limit_in_bytes", str(int(options.memory))
        elif controller == "pids" and options.pids:
            yield "pids.max", str(options.pids)
        elif controller == "cpu" and options.cpu:
            quota = max(1000, round(options.cpu * PERIOD))  # the least that the kernel accepts is a millisecond
            if self._unified:
                yield "cpu.max", f"{quota} {PERIOD}"
            else:
                yield "cpu.cfs_period_us", str(PERIOD)
                yield "cpu.cfs_quota_us", str(quota)

    def add(self, run: str, pid: int) -> None:
        """Move a process into the group of a run, unless it has ended; what it starts from then on is in the group."""
        for group in {*self._groups.values()}:
            with suppress(ProcessLookupError):
                (group / run / PROCESSES).write_text(str(pid))

    def killed(self, run: str) -> int:
        """Return how many processes of a run the kernel has killed because they exceeded the memory limit."""
        group = self._groups.get("memory")
        if group is None:
            return 0
        file = group / run / ("memory.events" if self._unified else "memory.oom_control")
        with suppress(OSError):
            counts = dict(line.split() for line in file.read_text().splitlines())
            return int(counts.get("oom_kill", 0))
        return 0

    def remove(self, run: str) -> None:
        """Kill what is in the group of a run, and remove the group.

        Raises:
            TimedOut: Processes still run after KILL_TIMEOUT.
        """
        deadline = time.monotonic() + KILL_TIMEOUT
        for group in {*self._groups.values()}:
            while (group / run).exists():
                with suppress(OSError):  # it has processes
                    (group / run).rmdir()
                    break
                _kill_all(group / run)
                if time.monotonic() > deadline:
                    raise TimedOut(f"processes of run {run} still run {KILL_TIMEOUT:g} s after they were killed")
                time.sleep(0.01)

    def close(self) -> None:
        """Remove the engine's group, unless runs are left in it."""
        for group in {*self._groups.values()}:
            with suppress(OSError):
                group.rmdir()


def _from_the_top(mount: Path, path: str) -> Iterator[Path]:
    """Yield a hierarchy's root and the groups on the way to a path."""
    place = mount
    yield place
    for part in filter(None, path.split("/")):
        place /= part
        yield place


def _enable(group: Path) -> list[str]:
    """Let the groups in a group have the controllers that it has itself, and return these."""
    found = [each for each in CONTROLLERS if each in (group / "cgroup.controllers").read_text().split()]
    enabled = (group / "cgroup.subtree_control").read_text().split()
    if missing := [f"+{each}" for each in found if each not in enabled]:
        (group / "cgroup.subtree_control").write_text(" ".join(missing))
    return found


def _kill_all(group: Path) -> None:
    pids = {int(line) for line in (group / PROCESSES).read_text().split()}
    for pid in pids - {0}:  # 0: a process in a PID namespace that this one does not see
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
