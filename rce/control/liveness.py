"""Liveness of control connections: the connecting side pings, and each side closes a connection that is silent.

A ping and its answer are a few bytes each and no calls, since the Master has one connection for each environment.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

CHECK_INTERVAL = 2.5  # seconds
PING_EVERY = 2  # checks
SILENT_CHECKS = 5  # after which the connection is closed: 12.5 to 15 s after the last bytes


class Liveness:
    """Check of one connection, which ends it when it is silent.

    It counts checks and not seconds: a process that was stopped itself handles what has arrived meanwhile first.
    """

    def __init__(self, broker: Any, pings: bool, silent: Callable[[], None]) -> None:
        """Start to check.

        Args:
            broker: The BaseBroker of the connection.
            pings: This side sends the pings.
            silent: Called once when the peer has been silent for too long.
        """
        self._broker = broker
        self._pings = pings
        self._silent = silent
        self._checks = 0
        self._silent_checks = 0
        self._timer = asyncio.get_running_loop().call_later(CHECK_INTERVAL, self._check)

    def stop(self) -> None:
        """Check no longer."""
        self._timer.cancel()

    def _check(self) -> None:
        self._checks += 1
        self._silent_checks = 0 if self._broker.heard else self._silent_checks + 1
        self._broker.heard = False
        if self._silent_checks == SILENT_CHECKS:
            self._silent()
            return
        if self._pings and self._checks % PING_EVERY == 0:
            self._broker.ping()
        self._timer = asyncio.get_running_loop().call_later(CHECK_INTERVAL, self._check)
