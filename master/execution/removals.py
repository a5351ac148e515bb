"""Removals of machines: their processes are disconnected, and all others refuse their certificates."""

from __future__ import annotations

from twisted.logger import Logger

from master.access.join_tokens import JoinTokens
from master.execution.lifecycle import Lifecycle
from master.execution.process_tracker import ProcessTracker
from master.graph import reconcile
from master.graph.state import State, at
from master.storage.periodic import repeat
from rce.net.tls import Tls

INTERVAL = 3.0  # seconds between checks

log = Logger()


class Removals:
    """Carries out removals, also those that `rce machine --config` makes in the database beside the Master."""

    def __init__(
        self, state: State, join_tokens: JoinTokens, tracker: ProcessTracker, lifecycle: Lifecycle, tls: Tls | None
    ) -> None:
        """Prepare; `tls` are the certificates of the Master."""
        self._state = state
        self._join_tokens = join_tokens
        self._tracker = tracker
        self._lifecycle = lifecycle
        self._tls = tls

    async def remove(self, machine: str) -> None:
        """Remove a machine: its processes and its certificate are refused until it is invited again.

        Raises:
            NotFound: There is no such machine.
        """
        await self._join_tokens.remove_machine(machine)
        await self.check()

    async def follow(self) -> None:
        """Look for removals, until cancelled."""
        await repeat(INTERVAL, self.check, "credentials of processes could not be checked")

    async def check(self) -> None:
        """Act on removals that are new."""
        await self.read()
        known = set(await self._join_tokens.names())
        for process in self._state.processes:
            name = process.name
            if process.role != "environment" and name not in known and not self._state.gone(name):
                # Before they are evicted, which may start them again elsewhere, with new tokens.
                await self._join_tokens.forget(*(each.name for each in self._state.environments.by(at(name))))
                await self._tracker.evict(name)

    async def read(self) -> None:
        """Refuse the certificates of removed machines here, and have all processes refuse them."""
        removed = await self._join_tokens.removals()
        if removed != self._state.removed_machines:
            self._state.removed_machines = removed
            if self._tls is not None:
                self._tls.set_removed(removed)
            self._lifecycle.apply(reconcile.announce_removals(self._state))
