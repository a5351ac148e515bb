"""Allocation of ROS domain ids, each to one environment on the whole host.

A domain is allocated by an exclusive lock on a file in a directory that all platforms on this host share. The lock
belongs to the open file description, so the environment's process inherits it and holds the domain even if the task set
is killed.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Sequence
from pathlib import Path

from rce.errors import NoCapacity

DIRECTORY = Path("/tmp/rce-domains")
# The ports of domains above 101 lie in Linux's ephemeral range, which begins at 32768. 0 is the default domain of ROS.
DOMAINS = range(1, 102)


class Domains:
    """The ROS domains of this host."""

    def __init__(self, directory: Path = DIRECTORY, domains: Sequence[int] = DOMAINS) -> None:
        self._directory = directory
        self._domains = domains

    def take(self) -> tuple[int, int]:
        """Allocate an unused domain; return it and the file descriptor that holds it.

        Raises:
            NoCapacity: All domains are in use.
        """
        in_use = _in_use()
        for domain in self._domains:
            if domain not in in_use and (lock := self.hold(domain)) is not None:
                return domain, lock
        raise NoCapacity(
            f"all {len(self._domains)} ROS domains of this host are in use; "
            "remove an environment or use an engine with networks of its own",
            domains=len(self._domains),
        )

    def hold(self, domain: int) -> int | None:
        """Return a file descriptor that holds this domain until it is closed; None if the domain is held already."""
        self._make_directory()
        lock = self._open(self._directory / str(domain))
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            return None
        return lock

    def _make_directory(self) -> None:
        try:
            self._directory.mkdir()
        except FileExistsError:
            return
        self._directory.chmod(0o1777)

    @staticmethod
    def _open(path: Path) -> int:
        """Open a file read-only, which is enough to lock it, so that files of other users can be locked too."""
        flags = os.O_RDONLY | os.O_NOFOLLOW
        try:
            return os.open(path, flags)
        except FileNotFoundError:
            return os.open(path, flags | os.O_CREAT, 0o644)


def _in_use() -> set[int]:
    """Return the domains that have participants on this host, by their UDP ports (RTPS 2.5, 9.6.2.3)."""
    ports: set[int] = set()
    for table in (Path("/proc/net/udp"), Path("/proc/net/udp6")):
        if table.exists():
            rows = table.read_text().splitlines()[1:]
            ports |= {int(row.split()[1].rpartition(":")[2], 16) for row in rows}
    return {(port - 7400) // 250 for port in ports if port >= 7400}
