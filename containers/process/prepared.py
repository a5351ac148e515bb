"""Endpoint processes that were started before their environments are known, so that these are ready sooner.

Each waits in a ROS domain of its own, has loaded all that an endpoint needs, and was never used before. It ends with
the task set that started it.
"""

from __future__ import annotations

import asyncio
import os
import secrets
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import msgspec
from twisted.logger import Logger

from containers.process.domains import Domains
from containers.process.tree import MARKER
from rce.errors import NoCapacity

COMMAND = (sys.executable, "-P", "-m", "endpoints.environment.prepared")
REFILL = 0.5  # seconds after one was taken, so that the start of its environment does not wait for the next one
END_TIMEOUT = 2.0  # seconds

log = Logger()


class Prepared(NamedTuple):
    """A process that waits for its environment; `marker` is in its variables, `lock` holds its ROS domain."""

    child: subprocess.Popen[bytes]
    marker: str
    domain: int
    lock: int

    def begin(self, variables: Mapping[str, str], directory: Path, output: Path) -> None:
        """Let the process serve an environment; raise OSError if it has ended."""
        order = {"variables": dict(variables), "directory": str(directory), "output": str(output)}
        assert self.child.stdin is not None
        with self.child.stdin as stdin:
            stdin.write(msgspec.json.encode(order) + b"\n")


class Pool:
    """Keeps `count` processes, whose variables are those of every endpoint."""

    def __init__(self, count: int, domains: Domains, variables: Mapping[str, str]) -> None:
        self._count = count
        self._domains = domains
        self._variables = dict(variables)
        self._waiting: list[Prepared] = []
        self._refill: asyncio.TimerHandle | None = None

    def fill(self) -> None:
        """Start what is missing."""
        self._refill = None
        while len(self._waiting) < self._count:
            try:
                self._waiting.append(self._start())
            except (NoCapacity, OSError) as error:
                log.warn("no further environment is prepared: {error}", error=str(error))
                return

    def take(self) -> Prepared | None:
        """Return the process that has waited longest, or None."""
        taken = None
        while self._waiting and taken is None:
            oldest = self._waiting.pop(0)
            if oldest.child.poll() is None:
                taken = oldest
            else:
                log.warn("a prepared environment has ended with status {status}", status=oldest.child.returncode)
                os.close(oldest.lock)
        if self._count and self._refill is None:
            self._refill = asyncio.get_running_loop().call_later(REFILL, self.fill)
        return taken

    def close(self) -> None:
        """End the processes that wait."""
        if self._refill is not None:
            self._refill.cancel()
        self._count = 0
        for each in self._waiting:
            if each.child.stdin is not None:
                each.child.stdin.close()  # by which it ends, and leaves its ROS domain
        for each in self._waiting:
            try:
                each.child.wait(END_TIMEOUT)
            except subprocess.TimeoutExpired:
                each.child.kill()
                each.child.wait()
            os.close(each.lock)
        self._waiting.clear()

    def _start(self) -> Prepared:
        domain, lock = self._domains.take()
        marker = secrets.token_hex(16)
        try:
            child = subprocess.Popen(
                COMMAND,
                cwd="/",
                env={**self._variables, MARKER: marker, "ROS_DOMAIN_ID": str(domain)},
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
                pass_fds=[lock],
            )
        except OSError:
            os.close(lock)
            raise
        return Prepared(child, marker, domain, lock)
