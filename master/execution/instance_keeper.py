"""Instance keeper: starts and stops instances of services by their load, and stops those that are idle."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from twisted.logger import Logger

from master.execution.effect_runner import EffectRunner, new_id
from master.execution.lifecycle import Lifecycle
from master.graph import instances
from master.graph.limits import Policy
from rce.errors import RceError

INTERVAL = 2.0  # seconds between checks

log = Logger()


class InstanceKeeper:
    """Keeps the number of instances; `limits_of` returns the policy of a publisher, `clock` seconds."""

    def __init__(
        self,
        runner: EffectRunner,
        lifecycle: Lifecycle,
        limits_of: Callable[[str], Policy],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._state = runner.state
        self._lifecycle = lifecycle
        self._limits_of = limits_of
        self._clock = clock
        self._empty_since: dict[str, float] = {}  # by environment; begins anew with the Master
        self._refused: dict[str, str] = {}  # reason why an offer cannot have another instance, by its name

    async def follow(self) -> None:
        """Check until cancelled."""
        while True:
            await asyncio.sleep(INTERVAL)
            self.check()

    def check(self) -> None:
        """Start instances that are missing, and stop those that have been idle."""
        now, empty = self._clock(), instances.empty(self._state)
        self._empty_since = {name: self._empty_since.get(name, now) for name in sorted(empty)}
        idle = instances.idle(self._state, self._empty_since, now)
        for environment in idle:
            log.info("{name} is idle: it is stopped", name=environment.name)
        if idle:
            self._lifecycle.apply(instances.stop(self._state, idle))
        for offer in self._state.offers:
            for _ in range(instances.missing(self._state, offer)):
                try:
                    chosen = instances.start_shared(self._state, offer, self._limits_of, new_id)
                except RceError as error:  # the publisher's limits, or no machine has room: tried again
                    self._refuse(offer.name, str(error))
                    break
                log.info("{name} runs {offer}", name=chosen.environment.name, offer=offer.name)
                self._refused.pop(offer.name, None)
                self._lifecycle.apply(chosen.outcome.plan)

    def _refuse(self, offer: str, reason: str) -> None:
        if self._refused.get(offer) != reason:
            self._refused[offer] = reason
            log.warn("{offer} gets no further instance: {reason}", offer=offer, reason=reason)
