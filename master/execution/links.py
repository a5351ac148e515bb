"""Data links that broke: opened again at both ends, after growing pauses if they break again and again."""

from __future__ import annotations

from twisted.logger import Logger

from master.execution.backoff import Backoff
from master.execution.effect_runner import EffectRunner, new_id
from master.execution.lifecycle import STEADY, Lifecycle
from master.graph import wiring
from master.graph.records import Process
from rce.control.calls.call import Nothing
from rce.control.calls.endpoints import LinkLost
from rce.control.connection import Handlers

RETRY_FIRST, RETRY_MOST = 0.1, 5.0  # seconds

log = Logger()


class Links:
    """Handles the reports of endpoints that lost a link."""

    def __init__(self, runner: EffectRunner, lifecycle: Lifecycle) -> None:
        self._runner = runner
        self._state = runner.state
        self._lifecycle = lifecycle
        self._backoff = Backoff(RETRY_FIRST, RETRY_MOST, STEADY)
        self._reopening: set[str] = set()  # links that wait for their pause to end

    def add_handlers(self, handlers: Handlers, process: Process) -> None:
        """Answer the reports of an endpoint."""
        handlers.on(LinkLost, lambda call: self.lost(process, call))

    async def lost(self, process: Process, call: LinkLost) -> Nothing:
        """Open a lost link again. Both ends report it; the second report is ignored."""
        link = self._state.links.get(call.link)
        if link is None or process.name not in (link.listener, link.dialler) or call.link in self._reopening:
            return Nothing()
        log.info("link {link} is lost: {reason}", link=call.link, reason=call.reason)
        pause = self._backoff.after_failure(f"{link.listener} {link.dialler} {link.alone_for}")
        if pause:
            self._reopening.add(call.link)
            self._runner.later(pause, lambda: self._reopen(call.link))
        else:
            self._lifecycle.apply(wiring.reopen(self._state, call.link, new_id))
        return Nothing()

    async def _reopen(self, link: str) -> None:
        self._reopening.discard(link)
        self._lifecycle.apply(wiring.reopen(self._state, link, new_id))
