"""Data links that break are opened again, at both ends, and after growing pauses if they break again and again."""

from __future__ import annotations

from twisted.logger import Logger

from master import wiring
from master.lifecycle import STEADY
from master.pauses import Pauses
from master.records import Process
from master.rim import Rim, ids
from rce.calls.call import Nothing
from rce.calls.endpoints import LinkLost
from rce.control import Handlers

RETRY_FIRST, RETRY_MOST = 0.1, 5.0  # seconds

log = Logger()


class Links:
    """The reports of endpoints that lost one."""

    def __init__(self, rim: Rim) -> None:
        self._rim = rim
        self._state = rim.state
        self._breaks = Pauses(RETRY_FIRST, RETRY_MOST, STEADY)
        self._reopening: set[str] = set()  # links that broke before, until they are opened again

    def add_to(self, handlers: Handlers, process: Process) -> None:
        handlers.on(LinkLost, lambda call: self.lost(process, call))

    async def lost(self, process: Process, call: LinkLost) -> Nothing:
        link = self._state.links.get(call.link)
        if link is None or process.name not in (link.listener, link.dialler) or call.link in self._reopening:
            return Nothing()
        log.info("link {link} is lost: {reason}", link=call.link, reason=call.reason)
        pause = self._breaks.after(f"{link.listener} {link.dialler} {link.alone_for}")
        if pause:
            self._reopening.add(call.link)
            self._rim.later(pause, lambda: self._reopen(call.link))
        else:
            self._rim.apply(wiring.reopen(self._state, call.link, ids))
        return Nothing()

    async def _reopen(self, link: str) -> None:
        self._reopening.discard(link)
        self._rim.apply(wiring.reopen(self._state, link, ids))
